"""Thresholds of bouncing: read from a sweep's grid, and refined beyond the grid.

A grid has a threshold if its cells are at rest up to some gamma and the next cell bounces. From rest it is
refined by bisection. On a ramp the refinement continues in smaller steps from the stored state of the last
cell before the change. A step beyond the change is halved and repeated from the cell before: the step itself
excites the spring, more so with less damping, and may have caused the change. The refinement ends when
neither the step, nor the sum of the accepted steps of its size, exceeds half the tolerance.

Just below the fold at which a cycle ends, bouncing lasts for long without a cycle. So a cell of a refinement
bounces if its cycle is certified, or if it is aperiodic after PATIENCE plate periods.
"""

import math
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Cell, Outcome, Start
from kernel.threshold import threshold
from worker import store
from worker.spec.axes import LARGEST, SMALLEST
from worker.study.layout import COMPUTED
from worker.sweep import SweepSpec
from worker.sweep.specification import UNTIL
from worker.sweep.task import run_cells

#: Limit on the cells computed for one threshold, beside those of a bisection.
MAX_CELLS: Final = 2_000

#: Typical number of cells per threshold, to estimate the cost of a request.
TYPICAL_CELLS: Final = 40

#: Plate periods before the window of a refinement's cell that is not certified, and the limit for one that
#: still settles.
PATIENCE: Final = UNTIL
SETTLES_UNTIL: Final = 4 * UNTIL

#: Flights kept of a refinement's cell: a thousand plate periods of a spring that rebounds.
_FLIGHTS: Final = 10_000

BOUNCING: Final = (Outcome.PERIODIC, Outcome.APERIODIC)


class Status(StrEnum):
    """The result for one threshold of a sweep."""

    FOUND = "found"
    BELOW = "below the grid"  # the lowest gamma bounces already
    ABOVE = "above the grid"  # every cell is at rest, also at the highest gamma
    #: Up: every cell is at rest, and by Eq. 25 would be at every gamma that a specification may have.
    #: Down: no cell of the ramp bounces, so that no bouncing ends.
    NEVER = "never bounces"
    NOT_RAMPED = "not ramped"  # the sweep does not have this direction
    NOT_REFINED = "not refined"  # the grid holds the change, refinement reached its limit
    # The deciding cell is neither at rest nor bouncing: the name of its outcome.
    MISSING = "missing"
    UNRESOLVED = "unresolved"
    DIVERGED = "diverged"
    SETTLING = "settling"


#: The status by the outcome of the lowest cell not at rest.
_BY_OUTCOME: Final = {
    int(outcome): Status.FOUND if outcome in BOUNCING else Status[outcome.name]
    for outcome in Outcome
    if outcome is not Outcome.AT_REST
}


class OnGrid(NamedTuple):
    """The threshold on one line of cells along gamma.

    resting, bouncing: indices along gamma of the cells that bracket it; None if no two cells do. They are
    neighbours if the threshold was found. Otherwise the cells between are undecided, and refinement may
    decide them.
    """

    status: Status
    resting: int | None = None
    bouncing: int | None = None


class Refined(NamedTuple):
    """Thresholds in gamma and their statuses, one per value of omega; NaN unless found."""

    up: tuple[float, ...]  # the lowest gamma that bounces, ascending or from rest
    down: tuple[float, ...]  # the lowest gamma that bounces, descending
    up_status: tuple[Status, ...]
    down_status: tuple[Status, ...]


def on_grid(outcome: NDArray[np.uint8], down: bool, endless: bool) -> OnGrid:
    """The threshold of one line of cells.

    outcome: (n_gamma,) in ascending order of gamma. down: the line was ramped down. endless: no
    gamma makes the spring bounce from rest, see `endless_rest`.
    """
    moving = np.flatnonzero(outcome != Outcome.AT_REST)
    if not len(moving):
        return OnGrid(Status.NEVER if down or endless else Status.ABOVE)
    lowest = int(moving[0])
    status = _BY_OUTCOME[int(outcome[lowest])]
    if lowest == 0:
        return OnGrid(Status.BELOW if status is Status.FOUND else status)
    deciding = np.isin(outcome[lowest:], (*BOUNCING, Outcome.AT_REST, Outcome.MISSING))
    decided = lowest + np.flatnonzero(deciding)
    if not len(decided) or outcome[decided[0]] not in BOUNCING:
        return OnGrid(status)
    return OnGrid(status, lowest - 1, int(decided[0]))


def endless_rest(spec: SweepSpec, omega: NDArray[np.float64], xi: float) -> NDArray[np.bool_]:
    """Whether springs at rest (n,) bounce at no gamma that a specification may have, by Eq. 25.

    An undamped spring at omega = sqrt(2) is one. A ball bounces everywhere above 1.
    """
    if spec.model.kind == "ball":
        return np.zeros(len(omega), np.bool_)
    return np.asarray(threshold(omega, xi) > LARGEST)


def by_bisection(spec: SweepSpec, url: str, xi: int, omegas: tuple[int, ...], tolerance: float) -> Refined:
    """The thresholds of a stored sweep, to `tolerance` in gamma.

    spec: from rest, or a ramp along gamma. xi, omegas: indices on the sweep's axes. Raises a
    `store.StoreError`.
    """
    results = {name: [(math.nan, Status.NOT_RAMPED)] * len(omegas) for name in ("up", "down")}
    endless = endless_rest(spec, spec.axis_values("omega")[list(omegas)], float(spec.axis_values("xi")[xi]))
    fine = _patient(spec)
    for direction, name in enumerate(spec.directions):
        down = name == "down"
        for i, omega in enumerate(omegas):
            bracket = _on_line(spec, url, (direction, xi, omega), down, bool(endless[i]))
            result = math.nan, bracket.status
            if bracket.resting is not None and bracket.bouncing is not None:
                edge = (bracket.bouncing, bracket.resting) if down else (bracket.resting, bracket.bouncing)
                result = _refine_line(fine, url, (direction, xi, omega), edge, tolerance, down)
            results["down" if down else "up"][i] = result
    return Refined(
        tuple(value for value, _ in results["up"]),
        tuple(value for value, _ in results["down"]),
        tuple(status for _, status in results["up"]),
        tuple(status for _, status in results["down"]),
    )


def _on_line(spec: SweepSpec, url: str, line: tuple[int, int, int], down: bool, endless: bool) -> OnGrid:
    """The threshold on the line of cells at indices (direction, xi, omega).

    Cells that decide it but were filled in from others are computed first.
    """
    direction, xi, omega = line
    names = ("outcome", COMPUTED) if spec.fills_in else ("outcome",)
    stored = store.read_slice(url, names, direction=direction, xi=xi, omega=omega)
    outcome = stored["outcome"]
    computed = stored.get(COMPUTED, np.ones(len(outcome)))
    while True:
        bracket = on_grid(outcome, down, endless)
        lowest = next(iter(np.flatnonzero(outcome != Outcome.AT_REST)), None)
        cells = (bracket.resting, lowest, bracket.bouncing)
        deciding = {int(i) for i in cells if i is not None and not computed[i]}
        if not deciding:
            return bracket
        values = float(spec.axis_values("omega")[omega]), float(spec.axis_values("xi")[xi])
        for i in deciding:
            outcome[i], _ = _run(_patient(spec), Cell(float(spec.axis_values("gamma")[i]), *values), None)
            computed[i] = 1


def _patient(spec: SweepSpec) -> SweepSpec:
    """The specification of a refinement's cells: they may settle for longer, and have no exponents.

    They keep so many flights that hops are seen to die out.
    """
    until = max(spec.settles_until or 0, SETTLES_UNTIL, PATIENCE + spec.observe)
    return spec.model_copy(update={"keep": _FLIGHTS, "exponents": 0, "settle": "auto", "until": until})


def _refine_line(
    spec: SweepSpec, url: str, line: tuple[int, int, int], edge: tuple[int, int], tolerance: float, down: bool
) -> tuple[float, Status]:
    """The threshold on the line at indices (direction, xi, omega), and its status; NaN unless found.

    edge: indices along gamma of the cells before and after the change.
    """
    before, after = edge
    direction, xi, omega = line
    gamma = spec.axis_values("gamma")
    values = spec.axis_values("omega")[omega], spec.axis_values("xi")[xi]
    cell = Cell(float(gamma[before]), *map(float, values))
    beyond = float(gamma[after])
    if spec.ramp_axis is None:
        return _search_upward(spec, cell, gamma[after:], tolerance)
    for i in range(before, len(gamma)):
        state = store.read_slice(url, ("end_state",), direction=direction, xi=xi, omega=omega, gamma=i)
        start = Start(state["end_state"], cell._replace(gamma=float(gamma[i])))
        # The window of a cell of the ramp may have been too short to show that its bouncing ends.
        if not down or _run(spec, start.cell, start)[0] in BOUNCING:
            return _ramp_on(spec, start, beyond - start.cell.gamma, tolerance, down)
    return math.nan, Status.NOT_REFINED


def _search_upward(
    spec: SweepSpec, cell: Cell, values: NDArray[np.float64], tolerance: float
) -> tuple[float, Status]:
    """From rest: the threshold between `cell`, at rest, and the first of these higher gammas that bounces.

    The window of a cell of the sweep may have been too short to show that its bouncing ends.
    """
    for gamma in map(float, values[:MAX_CELLS]):
        outcome, _ = _run(spec, cell._replace(gamma=gamma), None)
        if outcome in BOUNCING:
            return _bisect(spec, cell, gamma, tolerance)
        if outcome != Outcome.AT_REST:
            return math.nan, _BY_OUTCOME[outcome]
        cell = cell._replace(gamma=gamma)
    return math.nan, Status.ABOVE if len(values) <= MAX_CELLS else Status.NOT_REFINED


def _bisect(spec: SweepSpec, cell: Cell, bouncing: float, tolerance: float) -> tuple[float, Status]:
    """From rest: the threshold between `cell`, at rest, and the higher gamma `bouncing`."""
    resting = cell.gamma
    while bouncing - resting > tolerance:
        middle = 0.5 * (resting + bouncing)
        if not resting < middle < bouncing:
            break
        outcome, _ = _run(spec, cell._replace(gamma=middle), None)
        if outcome == Outcome.AT_REST:
            resting = middle
        elif outcome in BOUNCING:
            bouncing = middle
        else:
            return math.nan, _BY_OUTCOME[outcome]
    return bouncing, Status.FOUND


def _ramp_on(
    spec: SweepSpec, start: Start, step: float, tolerance: float, down: bool
) -> tuple[float, Status]:
    """On a ramp: the threshold beyond `start`, less than the signed `step` away.

    NOT_REFINED after MAX_CELLS cells, and below the lowest gamma of specifications.
    """
    same, changed = (BOUNCING, (Outcome.AT_REST,)) if down else ((Outcome.AT_REST,), BOUNCING)
    advance = 0.0  # sum of the accepted steps since the last halving
    step *= 0.5
    for _ in range(MAX_CELLS):
        cell = start.cell._replace(gamma=start.cell.gamma + step)
        if cell.gamma < SMALLEST or cell.gamma == start.cell.gamma:
            break
        outcome, end = _run(spec, cell, start)
        if outcome in same:
            start, advance = Start(end, cell), advance + abs(step)
            continue
        # An undecided cell starts no further cell: a smaller step may decide.
        if max(abs(step), advance) <= 0.5 * tolerance:
            if outcome not in changed:  # a cell at the threshold itself may be undecided
                further, _ = _run(spec, cell._replace(gamma=cell.gamma + step), start)
                if further not in changed:
                    return math.nan, _BY_OUTCOME[outcome]
            return (start.cell.gamma if down else cell.gamma), Status.FOUND
        step, advance = 0.5 * step, 0.0
    return math.nan, Status.NOT_REFINED


def _run(spec: SweepSpec, cell: Cell, start: Start | None) -> tuple[int, NDArray[np.float64]]:
    """Outcome and end state of one cell."""
    gamma, omega, xi = (np.array([value]) for value in cell)
    line = run_cells(spec, gamma, omega, xi, start, PATIENCE)
    return int(line.outcome[0]), line.end_state[0]
