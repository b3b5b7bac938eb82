"""What the chunks of a running job tell about the time that is left."""

import math

import numpy as np
import pytest

from service.jobs.run import BY_TABLE, RECENT, ChunkTimes
from worker.study import ChunkReport, Plan

LINE = Plan((1, 1, 40), (1, 1, 10), ("up", "down"), 2)


def after(
    plan: Plan, took: list[float], now: float, by_table: float | None = None, at_once: int = 1
) -> float | None:
    """The time left when the plan's first chunks took so many seconds, until `now`.

    by_table: of a chunk; by default as the last ones took. at_once: chunks computed at a time.
    """
    times = ChunkTimes(plan, np.mean(took[-RECENT:]) if by_table is None else by_table)
    reports = [ChunkReport(i, 10, each, each, ()) for i, each in enumerate(took)]
    times.note(reports[:1], took[0])
    times.note(reports[1:], now)
    to_come = np.arange(len(plan)) >= len(took)
    return times.left(to_come, now, at_once)


def test_there_is_no_rate_before_the_second_chunk_nor_by_a_small_one():
    assert after(LINE, [3.0], 3.0) is None
    assert after(LINE, [3.0, 0.01], 6.0) is None
    assert after(LINE, [3.0, 3.0], 6.0) == pytest.approx(18.0)


def test_chunks_computed_side_by_side_do_not_count_as_computed_since_the_first_was_reported():
    rest = Plan((1, 1, 60), (1, 1, 10), ("rest",))
    assert after(rest, [7.0, 7.0], 7.1, at_once=2) == pytest.approx(4 * 7.0 / 2)
    assert after(rest, [7.0, 7.0, 7.0, 7.0], 14.1, at_once=3) == pytest.approx(2 * 7.1 / 3)


def test_a_ramp_takes_as_long_on_its_way_back_as_there():
    up = [1.0, 2.0, 4.0, 8.0]
    assert after(LINE, up, 15.0) == pytest.approx(15.0)
    assert after(LINE, [*up, 8.0, 4.0], 27.0) == pytest.approx(3.0)
    assert after(LINE, up[:3], 7.0) == pytest.approx(2 * 7 / 3 + 7.0)  # as the newest ones


def test_the_newest_steps_of_a_ramp_tell_the_next_ones():
    one_way = Plan((1, 1, 60), (1, 1, 10), ("up",), 2)
    assert after(one_way, [9.0, 1.0, 2.0, 3.0], 15.0) == pytest.approx(4.0)


def test_the_table_of_costs_counts_where_a_ramp_has_hardly_begun():
    one_way = Plan((1, 1, 60), (1, 1, 10), ("up",), 2)
    assert after(one_way, [3.0, 3.0], 6.0, by_table=3.6) == pytest.approx(4 * (3.0 * 2 / 6 + 3.6 * 4 / 6))
    for wrong, limit in ((100.0, BY_TABLE), (0.01, 1.0 / BY_TABLE)):
        assert after(one_way, [3.0, 3.0], 6.0, by_table=wrong) == pytest.approx(4 * 3.0 * limit)


def test_without_a_ramp_all_chunks_tell_alike_and_workers_share_them():
    rest = Plan((1, 1, 60), (1, 1, 10), ("up",))
    left = after(rest, [1.0, 2.0, 3.0], 1.0 + 5.0 / 2, at_once=2)
    assert left is not None
    assert math.isclose(left, 3 * 2.0 / 2)
