"""Refinement of thresholds: where bouncing begins or ends, finer than a sweep's grid.

Ramps continue from the stored state of the last grid cell before the change, in smaller steps. A step whose
cell is beyond the change is halved and repeated from the cell before: the step itself excites the spring, the
more so the less it is damped, and may have caused the change. This ends when neither the step, nor the sum
of the last accepted steps of its size, is larger than half the tolerance.

From rest there are no steps in gamma to excite the spring: the threshold is found by bisection, with every
cell started from rest.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Cell, Outcome, Start
from worker import store
from worker.spec import SMALLEST, SweepSpec
from worker.tasks import run_cells

#: Limit on the cells computed for one threshold on a ramp; beyond it the threshold is NaN.
MAX_CELLS: Final = 2_000

#: Typical number of cells per threshold, to estimate the cost of a request.
TYPICAL_CELLS: Final = 40

BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC)


class Refined(NamedTuple):
    """Thresholds in gamma, one per value of omega; NaN where the grid has no change or refinement fails.

    A direction that the sweep does not have is all NaN.
    """

    up: tuple[float, ...]  # the lowest gamma that bounces, ascending or from rest
    down: tuple[float, ...]  # the lowest gamma that bounces, descending


class _Edge(NamedTuple):
    """Indices along gamma of the last cell before a change, and of the first after it."""

    before: int
    after: int


def refine(spec: SweepSpec, url: str, xi: int, omegas: tuple[int, ...], tolerance: float) -> Refined:
    """The thresholds of a stored sweep, to `tolerance` in gamma.

    spec: from rest, or a ramp along gamma. xi, omegas: indices on the sweep's axes. Raises a
    `store.StoreError`.
    """
    fine = spec.model_copy(update={"keep": 1})
    thresholds: dict[str, list[float]] = {"up": [], "down": []}
    for omega in omegas:
        for direction, name in enumerate(spec.directions):
            row = store.read_slice(url, ("outcome",), direction=direction, xi=xi, omega=omega)["outcome"]
            down = name == "down"
            edge = _edge(row, down)
            line = (direction, xi, omega)
            value = math.nan if edge is None else _refine_line(fine, url, line, edge, tolerance, down)
            thresholds["down" if down else "up"].append(value)
    return Refined(*(tuple(thresholds[name]) or (math.nan,) * len(omegas) for name in Refined._fields))


def _edge(outcome: NDArray[np.uint8], down: bool) -> _Edge | None:
    """The lowest bouncing cell along gamma and the highest one at rest below it; None without both."""
    bouncing = np.flatnonzero(np.isin(outcome, BOUNCING))
    if not len(bouncing):
        return None
    lowest = int(bouncing[0])
    resting = np.flatnonzero(outcome[:lowest] == Outcome.AT_REST)
    if not len(resting) or np.any(outcome[:lowest] == Outcome.MISSING):
        return None
    return _Edge(lowest, int(resting[-1])) if down else _Edge(int(resting[-1]), lowest)


def _refine_line(
    spec: SweepSpec, url: str, line: tuple[int, int, int], edge: _Edge, tolerance: float, down: bool
) -> float:
    """The threshold on the line at indices (direction, xi, omega); NaN if it is not found."""
    direction, xi, omega = line
    gamma = spec.axis_values("gamma")
    values = spec.axis_values("omega")[omega], spec.axis_values("xi")[xi]
    cell = Cell(float(gamma[edge.before]), *map(float, values))
    beyond = float(gamma[edge.after])
    if spec.ramp_axis is None:
        return _bisect(spec, cell, beyond, tolerance)
    state = store.read_slice(url, ("end_state",), direction=direction, xi=xi, omega=omega, gamma=edge.before)
    return _ramp_on(spec, Start(state["end_state"], cell), beyond - cell.gamma, tolerance, down)


def _bisect(spec: SweepSpec, cell: Cell, bouncing: float, tolerance: float) -> float:
    """From rest: the threshold between `cell`, which is at rest, and the higher gamma `bouncing`."""
    resting = cell.gamma
    while bouncing - resting > tolerance:
        middle = 0.5 * (resting + bouncing)
        if not resting < middle < bouncing:
            break
        outcome, _ = _run(spec, cell._replace(gamma=middle), None)
        resting, bouncing = (middle, bouncing) if outcome == Outcome.AT_REST else (resting, middle)
    return bouncing


def _ramp_on(spec: SweepSpec, start: Start, step: float, tolerance: float, down: bool) -> float:
    """On a ramp: the threshold beyond `start`, less than one signed `step` of the grid away.

    NaN after MAX_CELLS cells, or below the lowest gamma of specifications.
    """
    advance = 0.0  # sum of the accepted steps since the last halving
    step *= 0.5
    for _ in range(MAX_CELLS):
        cell = start.cell._replace(gamma=start.cell.gamma + step)
        if cell.gamma < SMALLEST or cell.gamma == start.cell.gamma:
            return math.nan
        outcome, end = _run(spec, cell, start)
        # An unresolved or diverged cell has no usable final state: it counts as beyond the change.
        if outcome not in (BOUNCING if down else (Outcome.AT_REST,)):
            if max(abs(step), advance) <= 0.5 * tolerance:
                return start.cell.gamma if down else cell.gamma
            step, advance = 0.5 * step, 0.0
        else:
            start, advance = Start(end, cell), advance + abs(step)
    return math.nan


def _run(spec: SweepSpec, cell: Cell, start: Start | None) -> tuple[int, NDArray[np.float64]]:
    """Outcome and end state of one cell."""
    gamma, omega, xi = (np.array([value]) for value in cell)
    line = run_cells(spec, gamma, omega, xi, start)
    return int(line.outcome[0]), line.end_state[0]
