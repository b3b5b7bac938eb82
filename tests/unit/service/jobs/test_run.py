"""What the chunks of a running job tell about the time that is left."""

import numpy as np
import pytest

from service.jobs.run import BY_TABLE, RECENT, ChunkTimes
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


def test_there_is_no_rate_before_the_second_chunk_nor_by_a_small_one():
    assert after(LINE, [3.0], 3.0) is None
    assert after(LINE, [3.0, 0.01], 6.0) is None
    assert after(LINE, [3.0, 3.0], 6.0) == pytest.approx(18.0)


def test_chunks_computed_side_by_side_do_not_count_as_computed_since_the_first_was_reported():
    rest = Plan((1, 1, 60), (1, 1, 10), ("rest",))
    assert after(rest, [7.0, 7.0], 7.1, at_once=2) == pytest.approx(4 * 7.0 / 2)
    assert after(rest, [7.0, 7.0, 7.0, 7.0], 14.1, at_once=3) == pytest.approx(7.1)


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


def test_without_a_ramp_the_last_worker_decides_and_chunks_take_as_long_as_those_beside_them():
    rest = Plan((1, 1, 120), (1, 1, 10), ("rest",))
    assert after(rest, [1.0] * 6 + [9.0] * 4, 21.0, at_once=2) == pytest.approx(9.0, rel=0.05)
    assert after(rest, [1.0] * 9, 5.0, at_once=2) == pytest.approx(2.0)  # one worker computes two of three


def test_chunks_under_way_take_less_but_may_take_longer_than_expected():
    rest = Plan((1, 1, 60), (1, 1, 10), ("rest",))
    assert after(rest, [2.0] * 4, 5.5, at_once=2, elapsed={4: 1.5, 5: 0.5}) == pytest.approx(1.5)
    assert after(rest, [2.0] * 4, 14.0, at_once=2, elapsed={4: 8.0, 5: 8.0}) == pytest.approx(1.0 * 24 / 22)
