"""Thresholds of bouncing: read from a sweep's grid, and refined beyond the grid.

A grid has a threshold if its cells are at rest up to some gamma and the next cell bounces. From rest it is
refined by bisection. On a ramp the refinement continues in smaller steps from the stored state of the last
cell before the change. A step beyond the change is halved and repeated from the cell before: the step itself
excites the spring, more so with less damping, and may have caused the change. The refinement ends when
neither the step, nor the sum of the accepted steps of its size, exceeds half the tolerance.

Just below the end of a cycle, or of chaos, bouncing lasts for long before it ends. So a cell of a refinement
bounces if its cycle is certified, or if it is aperiodic after PATIENCE plate periods. The cell that stands
for bouncing at the threshold must be certified, or last for LASTING. If it does not, or if undecided cells
hide the threshold, all is sought again with that patience, and what is still undecided is passed over.
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

#: Typical number of cells per threshold, to estimate the cost of a request. One in a hundred thresholds, and
#: one in six at xi < 0.006, takes some 30 cells of LASTING besides: seconds.
TYPICAL_CELLS: Final = 40

#: Plate periods before the window of a refinement's cell that is not certified, and the limit for one that
#: still settles.
PATIENCE: Final = UNTIL
SETTLES_UNTIL: Final = 4 * UNTIL

#: Plate periods after which bouncing without a cycle is no transient.
LASTING: Final = 20 * UNTIL

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

_UNDECIDED: Final = (Status.UNRESOLVED, Status.DIVERGED, Status.SETTLING)


class OnGrid(NamedTuple):
    """The threshold on one line of cells along gamma.

    resting, bouncing: indices along gamma of the cells that bracket it; None if no two cells do. They are
    neighbours if the threshold was found. Otherwise the cells between are undecided, and refinement may
    decide them.
    """

    status: Status
    resting: int | None = None
    bouncing: int | None = None


class _Bouncing(NamedTuple):
    """A cell that bounces, and the state in which it began; None at rest."""

    cell: Cell
    start: Start | None
    outcome: int


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
    for direction, name in enumerate(spec.directions):
        down = name == "down"
        for i, omega in enumerate(omegas):
            bracket = _on_line(spec, url, (direction, xi, omega), down, bool(endless[i]))
            result = math.nan, bracket.status
            if bracket.resting is not None and bracket.bouncing is not None:
                edge = (bracket.bouncing, bracket.resting) if down else (bracket.resting, bracket.bouncing)
                result = _refine_line(spec, url, (direction, xi, omega), edge, tolerance, down)
            results["down" if down else "up"][i] = result
    (ups, up_status), (downs, down_status) = (zip(*line, strict=True) for line in results.values())
    return Refined(ups, downs, up_status, down_status)


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
        for i in deciding:
            outcome[i], _ = _run(spec, spec.cell_at(xi, omega, i), None, PATIENCE)
            computed[i] = 1


def _refine_line(
    spec: SweepSpec, url: str, line: tuple[int, int, int], edge: tuple[int, int], tolerance: float, down: bool
) -> tuple[float, Status]:
    """The threshold on the line at indices (direction, xi, omega), and its status; NaN unless found.

    edge: indices along gamma of the cells before and after the change.
    """
    found = _search(spec, url, line, edge, tolerance, down, PATIENCE)
    if found in _UNDECIDED or (isinstance(found, _Bouncing) and not _lasts(spec, found)):
        found = _search(spec, url, line, edge, tolerance, down, LASTING)
    return (found.cell.gamma, Status.FOUND) if isinstance(found, _Bouncing) else (math.nan, found)


def _lasts(spec: SweepSpec, found: _Bouncing) -> bool:
    """Whether the cell is on a cycle, or bounces for LASTING plate periods."""
    if found.outcome == Outcome.PERIODIC:
        return True
    return _run(spec, found.cell, found.start, LASTING)[0] in BOUNCING


def _search(
    spec: SweepSpec, url: str, line: tuple[int, int, int], edge: tuple[int, int], tolerance: float,
    down: bool, patience: int,
) -> _Bouncing | Status:  # fmt: skip
    """The cell at the threshold, by this patience, or why there is none; otherwise as `_refine_line`."""
    before, after = edge
    direction, xi, omega = line
    gamma, cell = spec.axis_values("gamma"), spec.cell_at(xi, omega, before)
    beyond = float(gamma[after])
    if spec.ramp_axis is None:
        return _search_upward(spec, cell, gamma[after:], tolerance, patience)
    for i in range(before, len(gamma)):
        state = store.read_slice(url, ("end_state",), direction=direction, xi=xi, omega=omega, gamma=i)
        start = Start(state["end_state"], cell._replace(gamma=float(gamma[i])))
        if not down:
            return _ramp_on(spec, start, None, beyond - start.cell.gamma, tolerance, patience)
        # The window of a cell of the ramp may have been too short to show that its bouncing ends.
        known = _Bouncing(start.cell, start, _run(spec, start.cell, start, patience)[0])
        if known.outcome in BOUNCING:
            return _ramp_on(spec, start, known, beyond - start.cell.gamma, tolerance, patience)
    return Status.NOT_REFINED


def _search_upward(
    spec: SweepSpec, cell: Cell, values: NDArray[np.float64], tolerance: float, patience: int
) -> _Bouncing | Status:
    """From rest: the threshold between `cell`, at rest, and the first of these higher gammas that bounces.

    The window of a cell of the sweep may have been too short to show that its bouncing ends.
    """
    status = Status.ABOVE if len(values) <= MAX_CELLS else Status.NOT_REFINED
    for gamma in map(float, values[:MAX_CELLS]):
        higher = cell._replace(gamma=gamma)
        outcome, _ = _run(spec, higher, None, patience)
        if outcome in BOUNCING:
            return _bisect(spec, cell.gamma, _Bouncing(higher, None, outcome), tolerance, patience)
        if outcome == Outcome.AT_REST:
            cell = higher
        else:  # it is passed over, as on the grid
            status = _BY_OUTCOME[outcome]
    return status


def _bisect(
    spec: SweepSpec, resting: float, found: _Bouncing, tolerance: float, patience: int
) -> _Bouncing | Status:
    """From rest: the threshold between the gamma `resting` and the higher cell that was found to bounce.

    First the lowest cell that is not at rest is sought; if that is undecided, the lowest above that bounces.
    """
    low, high, outcome = resting, found.cell.gamma, found.outcome
    for passed in ((Outcome.AT_REST,), set(Outcome) - set(BOUNCING)):
        while high - low > tolerance:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            cell = found.cell._replace(gamma=middle)
            tried, _ = _run(spec, cell, None, patience)
            if tried in passed:
                low = middle
                continue
            high, outcome = middle, tried
            if outcome in BOUNCING:
                found = _Bouncing(cell, None, outcome)
        if outcome not in BOUNCING and patience < LASTING:
            return _BY_OUTCOME[outcome]
        low, high = high, found.cell.gamma
    return found


def _ramp_on(
    spec: SweepSpec, start: Start, known: _Bouncing | None, step: float, tolerance: float, patience: int
) -> _Bouncing | Status:
    """On a ramp: the threshold beyond `start`, less than the signed `step` away.

    known: on a ramp down, the cell of `start`, which bounces. NOT_REFINED after MAX_CELLS cells, and below
    the lowest gamma of specifications.
    """
    down = known is not None
    same, changed = (BOUNCING, (Outcome.AT_REST,)) if down else ((Outcome.AT_REST,), BOUNCING)
    advance = 0.0  # sum of the accepted steps since the last halving
    step *= 0.5
    for _ in range(MAX_CELLS):
        cell = start.cell._replace(gamma=start.cell.gamma + step)
        if cell.gamma < SMALLEST or cell.gamma == start.cell.gamma:
            break
        outcome, end = _run(spec, cell, start, patience)
        fine = max(abs(step), advance) <= 0.5 * tolerance
        if fine and outcome not in (*same, *changed):  # a cell at the threshold itself may be undecided
            cell = cell._replace(gamma=cell.gamma + step)
            outcome, end = _run(spec, cell, start, patience)
        if outcome in BOUNCING:
            known = _Bouncing(cell, start, outcome)
        if outcome in same:
            advance += abs(cell.gamma - start.cell.gamma)
            start = Start(end, cell)
            continue
        # An undecided cell starts no further cell: a smaller step may decide.
        if fine:
            if known and (outcome in changed or (patience == LASTING and (down or known.cell > start.cell))):
                return known
            return _BY_OUTCOME[outcome]
        step, advance = 0.5 * step, 0.0
    return Status.NOT_REFINED


def _run(spec: SweepSpec, cell: Cell, start: Start | None, patience: int) -> tuple[int, NDArray[np.float64]]:
    """The outcome of a refinement's cell, and its end state (6,).

    It may settle for longer, has no exponents, and keeps enough flights to show that hops die out.
    """
    until = max(spec.settles_until or 0, SETTLES_UNTIL, patience + spec.observe)
    patient = spec.model_copy(update={"keep": _FLIGHTS, "exponents": 0, "settle": "auto", "until": until})
    line = run_cells(patient, [np.array([value]) for value in cell], start, patience)
    return int(line.outcome[0]), line.end_state[0]
