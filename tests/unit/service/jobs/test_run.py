"""What the chunks of a running job tell about the time that is left."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tables import for_each

from service.jobs import run as module
from service.jobs.run import BY_TABLE, RECENT, ChunkTimes, JobRun
from worker.study import ChunkReport, Plan

LINE = Plan((1, 1, 40), (1, 1, 10), ("up", "down"), 2)


def after(
    plan: Plan,
    took: list[float],
    now: float,
    by_table: float | None = None,
    at_once: int = 1,
    elapsed: dict[int, float] | None = None,
) -> float | None:
    """The time left when the plan's first chunks took so many seconds, until `now`.

    by_table: of a chunk; by default as the last ones took. at_once: chunks computed at a time. elapsed:
    seconds of chunks in flight.
    """
    times = ChunkTimes(plan, np.mean(took[-RECENT:]) if by_table is None else by_table)
    reports = [ChunkReport(i, 10, each, each, ()) for i, each in enumerate(took)]
    times.note(reports[:1], took[0])
    times.note(reports[1:], now)
    to_come = np.arange(len(plan)) >= len(took)
    return times.left(to_come, now, at_once, elapsed or {})


REST, LONG, ONE_WAY, LINES = (
    Plan((1, 1, 60), (1, 1, 10), ("rest",)),
    Plan((1, 1, 120), (1, 1, 10), ("rest",)),
    Plan((1, 1, 60), (1, 1, 10), ("up",), 2),
    Plan((1, 2, 30), (1, 1, 10), ("up",), 2),
)
UP = [1.0, 2.0, 4.0, 8.0]


@for_each(("plan", "took", "now", "given", "left"), [
    # no rate before the second chunk, nor by a small one
    (LINE, [3.0], 3.0, {}, None), (LINE, [3.0, 0.01], 6.0, {}, None), (LINE, [3.0, 3.0], 6.0, {}, 18.0),
    # chunks computed side by side do not count as computed since the first was reported
    (REST, [7.0, 7.0], 7.1, {"at_once": 2}, 4 * 7.0 / 2), (REST, [7.0] * 4, 14.1, {"at_once": 3}, 7.1),
    (LINES, [7.0] * 4, 14.1, {"at_once": 2}, 2 * 7.0 / 2),
    # a ramp takes as long on its way back as there, or as its newest chunks
    (LINE, UP, 15.0, {}, 15.0), (LINE, [*UP, 8.0, 4.0], 27.0, {}, 3.0),
    (LINE, UP[:3], 7.0, {}, 2 * 7 / 3 + 7.0),
    (ONE_WAY, [9.0, 1.0, 2.0, 3.0], 15.0, {}, 4.0),
    # the table of costs counts where a ramp has hardly begun, up to a limit
    (ONE_WAY, [3.0, 3.0], 6.0, {"by_table": 3.6}, 4 * (3.0 * 2 / 6 + 3.6 * 4 / 6)),
    (ONE_WAY, [3.0, 3.0], 6.0, {"by_table": 100.0}, 4 * 3.0 * BY_TABLE),
    (ONE_WAY, [3.0, 3.0], 6.0, {"by_table": 0.01}, 4 * 3.0 / BY_TABLE),
    # without a ramp the last worker decides: of two one computes two of three chunks
    (LONG, [1.0] * 6 + [9.0] * 4, 21.0, {"at_once": 2}, 8.9956366),
    (LONG, [1.0] * 9, 5.0, {"at_once": 2}, 2.0),
    # chunks under way take less but may take longer than expected
    (REST, [2.0] * 4, 5.5, {"at_once": 2, "elapsed": {4: 1.5, 5: 0.5}}, 1.5),
    (REST, [2.0] * 4, 14.0, {"at_once": 2, "elapsed": {4: 8.0, 5: 8.0}}, 1.0 * 24 / 22),
])  # fmt: skip
def test_the_time_left_is_told_by_the_chunks_that_are_done(
    plan: Plan, took: list[float], now: float, given: dict[str, Any], left: float | None
):
    assert after(plan, took, now, **given) == (left and pytest.approx(left))


def test_other_jobs_delay_a_job_but_do_not_slow_it_down(monkeypatch: pytest.MonkeyPatch):
    now = [0.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    cost = SimpleNamespace(core_seconds=12.0, upper_core_seconds=12.0)
    job = SimpleNamespace(id="", seq=1, cancel_requested=False)
    run = JobRun(
        cast(Any, job), cast(Any, SimpleNamespace(plan=REST, cost=cost)), np.zeros(6, bool), cast(Any, None)
    )
    assert run.seconds_left(3, ahead=30.0) == 2 * 2.0 + 30.0 / 3  # by the table of costs
    now[0], run.delayed = 11.0, 10.0
    assert run.seconds_left(3) == 2 * 2.0 - 1.0
    for chunk, at, delayed in ((0, 2.0, 0.0), (1, 4.0, 0.0), (2, 26.0, 20.0)):
        now[0], run.delayed = at, delayed
        run.unsaved_reports.append(ChunkReport(chunk, 10, 2.0, 2.0, ()))
        left = run.seconds_left(1, ahead=30.0)
        run.mark_saved()
    assert left == 3 * 2.0 + 30.0
    assert run.expected_seconds == 3 * 2.0
