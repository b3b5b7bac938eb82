"""The plan: chunks partition the grid whatever its size and cut, and never wait for what comes later."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from studies import spec_of

import kernel.line  # noqa: F401 - registers the models' lanes
from worker.spec.errors import SpecTooLarge
from worker.study import Chunk, Plan
from worker.study.chunks import check_size
from worker.study.layout import INNER_BYTES
from worker.sweep import AXES, SweepSpec, schema
from worker.sweep.plan import MAX_SHARD_BYTES, cell_seconds, estimate, longest_cell_seconds, make_plan
from worker.sweep.schema import layout


def sweep(xi=1, omega=1, gamma=1, ramp=None, **more) -> SweepSpec:
    """A grid of so many values; `ramp` is (axis, direction)."""
    axes = {
        name: {"start": 1.0, "stop": 1.0 + (num > 1), "num": num}
        for name, num in (("xi", xi), ("omega", omega), ("gamma", gamma))
    }
    protocol = {"kind": "ramp", "axis": ramp[0], "direction": ramp[1]} if ramp else {"kind": "rest"}
    return SweepSpec(**(axes | {"protocol": protocol, "model": {"kind": "rigid"}} | more))


sizes = st.integers(1, 10)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("direction", ["up", "down", "both"])
@given(shape=st.tuples(sizes, sizes, sizes))
def test_each_line_of_a_ramp_is_walked_through_from_end_to_end(axis, direction, shape):
    """Going from predecessor to successor visits every cell of a line once, in the ramp's order.

    Chunks are numbered so that none comes before what it waits for.
    """
    spec = sweep(3, 4, 7, (axis, direction))
    plan = make_plan(spec, chunk_shape=shape)
    coords = layout(spec, plan.chunk_shape).coords
    assert [plan.number(*coords(chunk.slices)) for chunk in plan] == list(range(len(plan)))
    assert all(chunk.after is None or chunk.after < chunk.index for chunk in plan)
    n = plan.grid[AXES.index(axis)]
    up = [("up", place) for place in range(n)]
    down = [("down", place) for place in reversed(range(n))]
    expected = {"up": up, "down": down, "both": up + down}[direction]
    for last in plan[len(plan) - plan.lines :]:
        visited = [cell for chunk in line_up_to(plan, last) for cell in cells_along(spec, chunk, axis)]
        assert visited == expected


def line_up_to(plan: Plan, chunk: Chunk) -> list[Chunk]:
    """A chunk and all it waits for, first to last."""
    line = [chunk]
    while line[0].after is not None:
        line.insert(0, plan[line[0].after])
    return line


def cells_along(spec: SweepSpec, chunk: Chunk, axis: str) -> list[tuple[str, int]]:
    direction = spec.directions[chunk.direction]
    places = range(*chunk.spans[AXES.index(axis)])
    return [(direction, place) for place in (reversed(places) if direction == "down" else places)]


def test_what_is_harder_costs_more():
    def cost(**more):
        return cell_seconds(sweep(gamma=2, **more))

    soft = {"kind": "soft"}
    assert cost(settle=200) < cost(ramp=("gamma", "up"), settle=200) < cost(exponents=1)
    assert cost(model=soft) < cost(model=soft | {"penetration": 1e-6}) < cost(model=soft, settle=200)
    assert cost() < cost(until=50_000) < longest_cell_seconds(sweep(until=50_000))
    assert cost(model={"kind": "auto"}) == cost(model=soft)  # at most the exact one


def test_a_sweep_of_seconds_has_chunks_for_many_workers_and_a_small_one_few():
    assert len(make_plan(sweep(gamma=1000))) <= 8
    assert len(make_plan(sweep(xi=10, omega=30, gamma=1000))) > 16


def test_too_much_is_refused_with_the_limit():
    spec = sweep(gamma=1000)
    cost = estimate(spec, make_plan(spec))
    check_size(cost, max_cells=1000, max_bytes=1_061_000, max_core_seconds=cost.upper_core_seconds)
    for limit, rule in (
        ({"max_cells": 999}, r"^asks for 1,000 cells; at most 999 are .*: take fewer values on the axes$"),
        ({"max_bytes": 1_060_999}, r"^keep: asks for 1,061,000 bytes, 1,061 per cell; at most 1,060,999 are"),
        (
            {"max_core_seconds": 0.99 * cost.upper_core_seconds},
            r"^asks for up to \S+ core-seconds; at most \S+ are",
        ),
    ):
        with pytest.raises(SpecTooLarge, match=rule):
            check_size(cost, **limit)


@pytest.mark.parametrize("kind", ["rigid", "soft"])
def test_a_billion_cells_are_less_than_150_000_files(kind: str):
    grid = spec_of((0.5, 6.0, 1000), (0.1, 5.0, 1000), (0.02, 5.0, 1000), model={"kind": kind})
    spec = SweepSpec(**grid)
    plan, files = make_plan(spec), len(list(schema.arrays(spec)))
    assert len(plan) * files < 150_000
    cut = schema.layout(spec, plan.chunk_shape)
    assert cut.chunk_bytes <= MAX_SHARD_BYTES
    flights = cut.arrays[0]
    inner, whole = cut.inner_shape(flights), cut.chunk_shape(flights)
    assert 8 * math.prod(inner) <= INNER_BYTES
    assert all(n % part == 0 for n, part in zip(whole, inner, strict=True))
