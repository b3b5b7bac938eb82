"""Many clients poll while a job runs: all get answers, and the job ends.

`BOUNCE_TEST_P99=0.25,0.75` checks the latencies of a machine with nothing else to do.
"""

import os
import threading
import time
from pathlib import Path

import httpx2
import numpy as np
import pytest
from scripted import DEADLINE, costing, wait_for
from served import service_at

from worker.executors.dask import Dask

#: Limits of the 99th percentile of the latency (s), with 8 and with 64 connections.
P99 = [float(limit) for limit in os.environ.get("BOUNCE_TEST_P99", "60,60").split(",")]


@pytest.mark.parametrize(("connections", "limit"), [(8, P99[0]), (64, P99[1])])
def test_polling_is_answered_while_a_job_runs(tmp_path: Path, cluster: Dask, connections: int, limit: float):
    seconds: list[float] = []
    wrong: list[str] = []
    over = threading.Event()

    def poll(url: str) -> None:
        with httpx2.Client(base_url=url, timeout=DEADLINE) as client:
            while not over.wait(0.1):
                began = time.perf_counter()
                answer = client.get(path)
                seconds.append(time.perf_counter() - began)
                if answer.status_code >= 500:
                    wrong.append(answer.text)

    with service_at(tmp_path, cluster) as url:
        spec = costing(chunks=20, seconds=0.1).as_submitted()
        path = httpx2.post(f"{url}/v1/jobs", json=spec, timeout=DEADLINE).headers["Location"]
        threads = [threading.Thread(target=poll, args=[url]) for _ in range(connections)]
        for thread in threads:
            thread.start()
        wait_for(lambda: httpx2.get(url + path, timeout=DEADLINE).json()["state"] == "done")
        wait_for(lambda: len(seconds) > connections)
        over.set()
        for thread in threads:
            thread.join()
    assert wrong == []
    assert np.percentile(seconds, 99) <= limit
