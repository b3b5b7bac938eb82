"""Room: where bouncing begins or ends, finer than a sweep's grid; what a worker does for it.

A ramp is taken up again from the stored state of the last grid cell before the change and goes
on in smaller steps. A step that brings the change is halved, and its cell not believed: the
spring is still ringing from the step itself, the more so the less it is damped, and may have
been thrown off by that. So the ramp creeps on from where it was, until neither the step nor
all that the last steps of its size gained is larger than half the tolerance. Sweeps from rest
have no step to ring from: theirs is a plain bisection, each cell started from rest.

Imports the kernel by way of worker.tasks; nothing of the service.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Cell, Outcome, Start
from worker import store
from worker.spec import SMALLEST, SweepSpec
from worker.tasks import run_cells

#: Cells that one threshold may take; where they do not suffice there is no answer.
MOST_CELLS: Final = 2_000

#: Cells that one usually takes, for foreseeing what a request will cost.
USUAL_CELLS: Final = 40

BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC)


class Refined(NamedTuple):
    """Per value of omega asked for: NaN where the sweep holds no change, or it could not be followed."""

    up: tuple[float, ...]  # the lowest gamma that bounces, ascending or from rest
    down: tuple[float, ...]  # the lowest gamma that bounces, descending


class _Edge(NamedTuple):
    """The last cell before a change in a sweep's grid, and the first after it."""

    before: int
    after: int


def refine(spec: SweepSpec, url: str, xi: int, omegas: tuple[int, ...], tolerance: float) -> Refined:
    """The thresholds of a stored sweep at these places on its axes, to `tolerance` in gamma.

    The sweep is from rest or ramped along gamma. Raises a `store.StoreError`.
    """
    fine = spec.model_copy(update={"keep": 1})
    found: dict[str, list[float]] = {"up": [], "down": []}
    for omega in omegas:
        for direction, name in enumerate(spec.directions):
            row = store.read_slice(url, ("outcome",), direction=direction, xi=xi, omega=omega)["outcome"]
            down = name == "down"
            edge = _edge(row, down)
            place = (direction, xi, omega)
            value = math.nan if edge is None else _followed(fine, url, place, edge, tolerance, down)
            found["down" if down else "up"].append(value)
    return Refined(*(tuple(found[name]) or (math.nan,) * len(omegas) for name in Refined._fields))


def _edge(outcome: NDArray[np.uint8], down: bool) -> _Edge | None:
    """Where along gamma the lowest bouncing cell and the last resting one below it lie; None without both."""
    bouncing = np.flatnonzero(np.isin(outcome, BOUNCING))
    if not len(bouncing):
        return None
    lowest = int(bouncing[0])
    resting = np.flatnonzero(outcome[:lowest] == Outcome.AT_REST)
    if not len(resting) or np.any(outcome[:lowest] == Outcome.MISSING):
        return None
    return _Edge(lowest, int(resting[-1])) if down else _Edge(int(resting[-1]), lowest)


def _followed(
    spec: SweepSpec, url: str, place: tuple[int, int, int], edge: _Edge, tolerance: float, down: bool
) -> float:
    direction, xi, omega = place
    gamma = spec.axis_values("gamma")
    values = spec.axis_values("omega")[omega], spec.axis_values("xi")[xi]
    cell = Cell(float(gamma[edge.before]), *map(float, values))
    beyond = float(gamma[edge.after])
    if spec.ramp_axis is None:
        return _bisected(spec, cell, beyond, tolerance)
    state = store.read_slice(url, ("end_state",), direction=direction, xi=xi, omega=omega, gamma=edge.before)
    return _crept(spec, Start(state["end_state"], cell), beyond - cell.gamma, tolerance, down)


def _bisected(spec: SweepSpec, cell: Cell, bouncing: float, tolerance: float) -> float:
    """From rest: between a cell that rests and a higher gamma that bounces."""
    resting = cell.gamma
    while bouncing - resting > tolerance:
        middle = 0.5 * (resting + bouncing)
        if not resting < middle < bouncing:
            break
        outcome, _ = _run(spec, cell._replace(gamma=middle), None)
        resting, bouncing = (middle, bouncing) if outcome == Outcome.AT_REST else (resting, middle)
    return bouncing


def _crept(spec: SweepSpec, start: Start, step: float, tolerance: float, down: bool) -> float:
    """On a ramp: from `start`, before the change; the first `step` is the grid's own, with its sign."""
    gained = 0.0
    step *= 0.5
    for _ in range(MOST_CELLS):
        cell = start.cell._replace(gamma=start.cell.gamma + step)
        if cell.gamma < SMALLEST or cell.gamma == start.cell.gamma:
            return math.nan
        outcome, end = _run(spec, cell, start)
        # A cell without an answer is no place to go on from: it counts as beyond the change.
        if outcome not in (BOUNCING if down else (Outcome.AT_REST,)):
            if max(abs(step), gained) <= 0.5 * tolerance:
                return start.cell.gamma if down else cell.gamma
            step, gained = 0.5 * step, 0.0
        else:
            start, gained = Start(end, cell), gained + abs(step)
    return math.nan


def _run(spec: SweepSpec, cell: Cell, start: Start | None) -> tuple[int, NDArray[np.float64]]:
    """Outcome and end state of one cell."""
    gamma, omega, xi = (np.array([value]) for value in cell)
    line = run_cells(spec, gamma, omega, xi, start)
    return int(line.outcome[0]), line.end_state[0]
