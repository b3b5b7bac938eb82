"""A service in a job of a million chunks, killed twice: it goes on soon, and no stored chunk is lost."""

import os
import re
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from paths import CACHE
from scripted import wait_for
from stores import is_sound, store_in

from benchmarks.chunks import huge
from benchmarks.serving import Polls, Serving
from service.ledger.ledger import Ledger
from worker.studies import study_of
from worker.study.chunks import TARGET_SECONDS

#: Seconds until it goes on after a start, and of the 99th percentile of polls; on a quiet machine 5 and 0.2.
BACK = float(os.environ.get("BOUNCE_TEST_BACK", "60"))
P99 = float(os.environ.get("BOUNCE_TEST_P99", "5"))
#: Of computing between two kills.
SECONDS = 15.0
#: MiB of the service at most.
MEMORY = 500

SETTINGS = {
    "BOUNCE_MAX_CELLS": str(10**12),
    "BOUNCE_MAX_BYTES": str(10**15),
    "BOUNCE_MAX_CORE_SECONDS": "1e9",
    "BOUNCE_LONGEST_CHUNK_SECONDS": str(TARGET_SECONDS),
    "NUMBA_CACHE_DIR": str(CACHE),
}


@pytest.mark.timeout(600)
def test_a_job_of_a_million_chunks_survives_kills(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name, value in SETTINGS.items():
        monkeypatch.setenv(name, value)
    spec, done = huge(1_000_000), set[int]()
    for _ in range(3):
        service = Serving(tmp_path)
        try:
            job = service.submit(spec.as_submitted())  # the same each time
            began, before = time.monotonic(), service.cells_done(job)
            wait_for(lambda: service.cells_done(job) > before, seconds=BACK)  # noqa: B023
            assert time.monotonic() - began < BACK
            with Polls(service.port, job, 2, 0.05) as polls:
                time.sleep(SECONDS)
            assert polls.wrong == []
            assert np.percentile(polls.seconds, 99) < P99
            status = Path(f"/proc/{service.process.pid}/status").read_text()
            assert int(re.findall(r"VmHWM:\s+(\d+)", status)[0]) / 2**10 < MEMORY
            members = service.me.children(recursive=True)
        finally:
            service.process.kill()
            service.process.wait()
        assert psutil.wait_procs(members, timeout=60)[1] == []
        with Ledger(service.data / "ledger.sqlite") as ledger, ledger.reading() as reading:
            record = reading.find(Path(job).name)
            plan = study_of(spec).plan(spec, record.chunk_shape)
            assert len(plan) >= 800_000
            stored = set(reading.done_chunks(record, 0, len(plan)))
        assert done <= stored
        assert len(stored) > len(done)
        done = stored
    layout = study_of(spec).variables(spec, plan.chunk_shape)
    url = str(store_in(service.data, Path(job).name))
    assert all(is_sound(url, layout, plan[chunk]) for chunk in done)
