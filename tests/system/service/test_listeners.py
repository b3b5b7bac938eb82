"""Many who listen to the events of jobs."""

import asyncio
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx2
from scripted import DEADLINE, Held, sweep, wait_for

from benchmarks.attack import streams_at_once
from service.server import embedded
from service.settings import Settings

SWEEP: dict[str, Any] = {**sweep().as_submitted(), "name": "small"}


def test_listeners_are_limited_and_do_not_delay_the_shutdown(tmp_path: Path):
    settings = Settings(data=tmp_path, port=0, max_listeners=1, shutdown_seconds=1000)
    with httpx2.Client(timeout=DEADLINE) as client, ExitStack() as listening:
        with embedded.running(settings, Held()) as address:
            here = address + client.post(f"{address}/v1/jobs", json=SWEEP).headers["Location"]
            lines = listening.enter_context(client.stream("GET", f"{here}/events")).iter_lines()
            assert next(lines) == "event: progress"
            refused = client.get(f"{here}/events")
            assert (refused.status_code, int(refused.headers["Retry-After"]) > 0) == (503, True)
            assert "at most 1 at a time; poll the job" in refused.json()["detail"]
            began = time.monotonic()
        assert time.monotonic() - began < DEADLINE  # and does not wait shutdown_seconds for the open response


def test_of_more_listeners_than_allowed_the_others_are_told_to_come_again(tmp_path: Path):
    """At once, with the limit as it is: nobody waits for a place, and every place is free afterwards."""
    settings = Settings(data=tmp_path, port=0)
    allowed = settings.max_listeners
    with embedded.running(settings, Held()) as address, httpx2.Client(base_url=address) as client:
        here = client.post("/v1/jobs", json=SWEEP).headers["Location"]

        def statuses(count: int) -> Counter[int]:
            return asyncio.run(streams_at_once(address, here, count, {}))[0]

        assert statuses(allowed + 100) == {200: allowed, 503: 100}
        wait_for(lambda: statuses(allowed) == {200: allowed})
