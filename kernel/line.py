"""A line of cells, from arrays of parameters to arrays of records: the entry to the kernels.

Under the protocol `rest` every cell starts from rest, in a basin from its own state. A ramp carries the state
from cell to cell. The physical motion stays the same, and A is proportional to Gamma/Omega**2: so lengths in
plate amplitudes scale by (Gamma_old/Gamma_new)(Omega_new/Omega_old)**2, and velocities by
(Gamma_old/Gamma_new)(Omega_new/Omega_old) (docs/model.md, section 4).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel import cell
from kernel import exponents as lyapunov
from kernel.cell import CACHE_SIZE, RUN_FIELDS, Progress, Window
from kernel.certify import (
    CERTIFIED,
    Attempt,
    Search,
    allocate_attempt,
    allocate_search,
    begin_search,
    certified,
    follows_refused,
    has_candidate,
    lingers,
    move_search,
)
from kernel.exponents import Variations
from kernel.interface import (
    Phase,
    PlatePhase,
    advance_lanes,
    dimension,
    load_lane,
    phase_of,
    plate_phase,
    prepare,
    relative_margin,
    replay,
    unload_lane,
)
from kernel.models import variations as _variations  # noqa: F401 - registers the models' variations
from kernel.models.lanes import AT_ROOT, FALLBACK, K0, ROWS, SEARCHING, SHORT_FLIGHT, STATUS, TAU, index_of
from kernel.modes import Flights, move_flights
from kernel.numerics.first_root import ROOT
from kernel.numerics.jit import allocating, inlined, is_compiled, jit
from kernel.params import (
    LANES,
    STATE_FIELDS,
    KernelInputError,
    Line,
    Start,
    check_arrays,
    checked_states,
    empty_line,
)

#: More steps than any line takes.
_ALL: Final = 2**62


class Lanes(NamedTuple):
    """The lines under way, with a cell in each of LANES lanes, or in a single one."""

    table: Any  # (ROWS * LANES,) the phases, see `lanes`; None: each is computed by the scalar functions
    runs: Any  # (lanes, RUN_FIELDS) the cells' runs
    index: Any  # (lanes,) int64, the cell in each lane; -1: none
    counts: Any  # (2,) int64: lines put into a lane so far, cells done
    followed: Any  # (lanes,) bool, whether the cell is followed beyond its window
    ends: Any  # (lanes, RUN_FIELDS) the runs of followed cells at the window's end
    cache: Any  # (CACHE_SIZE,) the model's cache of a cell, without a table


def _allocate_lanes(lanes: int) -> Lanes:
    """Empty lanes, with a table if there are LANES."""
    table = None
    if lanes == LANES:
        table = np.zeros(ROWS * LANES)
        table[K0 * LANES : (K0 + 1) * LANES] = 1.0  # F = 1 keeps the arithmetic of idle lanes finite
    runs, ends = np.zeros((lanes, RUN_FIELDS)), np.zeros((lanes, RUN_FIELDS))
    followed = np.zeros(lanes, np.bool_)
    return Lanes(table, runs, np.full(lanes, -1), np.zeros(2, np.int64), followed, ends, np.zeros(CACHE_SIZE))


@jit
def lanes_used(lines: int) -> int:
    """Number of lanes for a batch of lines: one alone, one vector (half of all), or all."""
    if lines <= 1:
        return lines
    return LANES // 2 if lines <= LANES // 2 else LANES


@inlined
def _searching(table: Any, k: int) -> bool:
    """Whether lane k holds a phase that has not ended."""
    return False if table is None else table[STATUS * LANES + k] == SEARCHING


@inlined
def _ended(table: Any, k: int, run: Progress) -> bool:
    """Whether lane k holds the end of the run's phase; otherwise the scalar functions compute it.

    Counts of short flights, failed searches and contacts at their horizon may stay above their limit.
    """
    if table is None:
        return False
    if table[STATUS * LANES + k] == AT_ROOT:
        return not (run.in_flight and table[TAU * LANES + k] < SHORT_FLIGHT)
    return table[STATUS * LANES + k] != FALLBACK and run.in_flight


@inlined
def _scalar_phase(spring: Any, run: Progress, phi: PlatePhase) -> Phase:
    """The run's next phase by the scalar functions; a phase of length zero if the run has ended."""
    if run.ending != ROOT:
        return Phase(0.0, run.ending, run.in_flight, run.state, 0)
    return phase_of(spring, phi, run, cell.horizon_of(run))


@jit
def _write_record(
    spring: Any, line: Line, i: int, run: Progress, flights: Flights, first: int, window: Window
) -> None:
    cell.write_record(line, i, run, flights, first, window)
    line.outcome[i] = _settling_or(line.outcome[i], spring, run, flights, first)


@jit
def _settling_or(outcome: int, spring: Any, run: Progress, flights: Flights, first: int) -> int:
    """SETTLING for what still grows on the plate, and for hops that die out where rest is possible."""
    margin = relative_margin(spring)
    grows = outcome == cell.AT_REST and margin < cell.GROWS
    fades = outcome == cell.APERIODIC and margin > 0.0 and cell.fades(run, flights, first)
    return cell.SETTLING if grows or fades else outcome


@jit
def _after_window(
    spring: Any, before: Progress, run: Progress, i: int, k: int, window: Window, line: Line,
    flights: Flights, lanes: Lanes, variations: Variations | None, search: Search | None,
) -> Progress:  # fmt: skip
    """The run that follows `run`, which has ended after `before`: beyond its window, or in a later window.

    Writes the window's record. If no run follows, the cell is done and the returned run has ended.
    """
    first = k * flights.size
    lanes.cache[:] = 0.0
    if window.certify:
        if run.ending != CERTIFIED:
            _write_record(spring, line, i, run, flights, first, window)
            outcome = line.outcome[i]
            if search is not None and outcome == cell.SETTLING and follows_refused(k, search):
                line.outcome[i] = outcome = cell.APERIODIC
            elif search is not None and outcome == cell.APERIODIC and lingers(k, search):
                outcome = cell.SETTLING  # it goes on; where it cannot, it stays aperiodic
            run = cell.go_on(before, run, outcome, window)
        if run.ending != ROOT:
            lanes.counts[1] += 1
        return run
    if lanes.followed[k]:
        outcome = cell.decide(line.outcome[i], run, flights, first, window)
        line.outcome[i] = _settling_or(outcome, spring, run, flights, first)
        run, lanes.followed[k] = cell.load_run(lanes.ends[k]), False
    else:
        if variations is not None:
            lyapunov.write_exponents(line.lyapunov[i], run.ending, variations)
            line.lyapunov_error[i] = lyapunov.exponent_error(run.ending, variations, window.observe)
        _write_record(spring, line, i, run, flights, first, window)
        if line.outcome[i] in (cell.APERIODIC, cell.SETTLING):  # followed, to distinguish the two
            cell.store_run(run, lanes.ends[k])
            lanes.followed[k] = True
            return cell.follow(before, window)
    run = cell.extend(run, line.outcome[i], window)
    if run.ending != ROOT:
        lanes.counts[1] += 1
    elif variations is not None:
        lyapunov.begin_window(variations)
    return run


@allocating
def _gathered(
    springs: Any, runs: Any, window: Window, flights: Flights, lanes: Lanes, table: Any,
    search: Search | None, used: int,
) -> int:  # fmt: skip
    """Move the cells under way into the first lanes, when no line is left to begin: how many to advance."""
    index = lanes.index
    count = 0
    for k in range(used):
        count += index[k] >= 0
    most, k = min(used, lanes_used(count)), 0
    for last in range(most, used):
        if index[last] >= 0:
            while index[k] >= 0:
                k += 1
            for row in range(ROWS):
                table[row * LANES + k] = table[row * LANES + last]
            move_flights(flights, last * flights.size, k * flights.size)
            if search is not None and window.certify:
                move_search(search, last, k)
            springs[k], runs[k] = springs[last], runs[last]
            lanes.followed[k] = lanes.followed[last]
            for field in range(RUN_FIELDS):
                lanes.ends[k, field] = lanes.ends[last, field]
            index[k], index[last] = index[last], -1
    return most


@allocating
def _walk(
    plate: Any, gamma: Any, omega: Any, xi: Any, length: int, states: Any, window: Window, line: Line,
    flights: Flights, lanes: Lanes, table: Any, variations: Variations | None, search: Search | None,
    attempt: Attempt | None, steps: int,
) -> bool:  # fmt: skip
    """Run lines of `length` cells each for about `steps` phases or moves of all lanes; whether all is done.

    `states`: (n / length, 6) where each line begins, as in `cell.begin`. Fills `line`. The next call
    goes on from `flights`, `lanes`, `variations` and `search`. table: that of `lanes`; None is seen at
    compile time. variations: for the exponents of one cell at a time, or None. search: None with exponents
    and for a contact without variations; used if `window` certifies, with `attempt`.

    Each lane holds one cell and its phase. `advance_lanes` moves all on. A lane whose phase has ended goes
    through the landing or take-off here, and gets its next phase or, at the end of its window, the next cell
    of its line, or of the next line. Phases that lanes cannot compute well are computed by the scalar
    functions at once, so that a record depends on nothing but its cell and those before it on its line.

    In functions of their own, recording a phase and choosing the next cell cost `rigid` 2 to 4 % of its time.
    """
    index, counts = lanes.index, lanes.counts
    springs = [prepare(plate, max(i, 0), gamma[i], omega[i], xi[i]) for i in index]
    runs = [cell.load_run(lanes.runs[k]) for k in range(len(index))]
    state = np.zeros(len(STATE_FIELDS))
    lines = len(gamma) // length
    used = 1 if table is None else lanes_used(lines)
    idle = counts[0] == lines  # whether a lane has no line left to begin
    while counts[1] < len(gamma) and steps > 0:
        for lane in range(used):
            k = index_of(lane)
            if (index[k] < 0 and counts[0] == lines) or (index[k] >= 0 and _searching(table, k)):
                continue
            run, first = runs[k], k * flights.size
            # whether phi is plate_phase(run.phase) to the last digit, as a run paused here would compute it
            exact, phi = False, PlatePhase(0.0, 0.0, 1.0)
            while steps > 0 and (index[k] < 0 or not _searching(table, k)):
                steps -= 1
                i, turned = index[k], False  # whether phi is where the search of lane k ended
                if i >= 0:
                    before = run
                    if table is not None and _ended(table, k, run):
                        p, phi = unload_lane(springs[k], table, k, run)
                        turned = True
                    else:
                        from_rest = run.in_flight and run.state.gap == 0.0 and run.state.gap1 == 0.0
                        if from_rest and not window.certify:
                            run = replay(springs[k], run, window, flights, lanes.cache)
                        phi = phi if exact else plate_phase(run.phase)
                        p = _scalar_phase(springs[k], run, phi)
                    if variations is not None and not lanes.followed[k]:
                        lyapunov.carry(springs[k], before, run, p, window, variations)
                    run = cell.record(run, p, window, flights, first)
                    if (
                        search is not None
                        and attempt is not None
                        and window.certify
                        and has_candidate(run, k, window, flights, search)
                    ):
                        run = certified(springs[k], run, i, k, window, line, flights, search, attempt)
                    if run.ending != ROOT:
                        run = _after_window(
                            springs[k], before, run, i, k, window, line, flights, lanes, variations,
                            search,
                        )  # fmt: skip
                        turned = False
                if i < 0 or run.ending != ROOT:
                    i += 1
                    if i % length == 0:  # the next line
                        index[k] = -1
                        if counts[0] == lines:
                            idle = True
                            break
                        i = counts[0] * length
                        counts[0] += 1
                    index[k] = i
                    springs[k] = prepare(plate, i, gamma[i], omega[i], xi[i])
                    run = cell.begin(springs[k], i, length, gamma, omega, states, run, state, window)
                    if variations is not None:
                        lyapunov.start_variations(variations)
                    if search is not None and window.certify:
                        begin_search(search, k)
                if table is not None:
                    phi = PlatePhase(run.phase, phi.sin, phi.cos) if turned else plate_phase(run.phase)
                    exact = not turned
                    loaded = load_lane(springs[k], table, k, run, phi, cell.horizon_of(run))
                    table[STATUS * LANES + k] = SEARCHING if loaded else FALLBACK
            runs[k] = run
        if table is not None and steps > 0:
            if idle:
                used = _gathered(springs, runs, window, flights, lanes, table, search, used)
                idle = False
            advance_lanes(plate, table, used)
            steps -= 1
    for k in range(len(index)):
        cell.store_run(runs[k], lanes.runs[k])
    return bool(counts[1] == len(gamma))


def _check_plate(plate: Any, n: int) -> None:
    """Check that a model's `plate` function made this, for n cells. Raises KernelInputError."""
    if type(plate) not in prepare.registry:
        raise KernelInputError("plate", f"must be made by a model's `plate`, not a {type(plate).__name__}")
    for name, array in plate._asdict().items():
        if isinstance(array, np.ndarray) and array.shape != (n,):
            raise KernelInputError(name, f"must have the shape of gamma, ({n},), got {array.shape}")


def _first_states(
    starts: Sequence[Start | None], gamma: NDArray[np.float64], omega: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where each line begins, (lines, 6) in its first cell's units, NaN at rest. Raises KernelInputError."""
    if not starts or len(gamma) % len(starts):
        rule = "must be one for each of several lines of equal length"
        raise KernelInputError("start", f"{rule}, got {len(starts)} for {len(gamma)} cells")
    states = np.full((len(starts), len(STATE_FIELDS)), np.nan)
    for number, start in enumerate(starts):
        if start is not None:
            states[number] = start.state
            first = number * (len(gamma) // len(starts))
            cell.rescale(states[number], start.cell.gamma, start.cell.omega, gamma[first], omega[first])
    return states


class LineRun:
    """A line of cells under way: computed in parts, its state saved between them and restored elsewhere.

    The parts do not change the numbers.

    gamma, omega, xi: float64 (n,). plate: made by a model's `plate` function from its own arrays (n,); its
    type selects the model. With `carry` each cell continues from its predecessor's end, the first from
    `start` or from rest (None). A sequence of starts makes the cells as many lines of equal length, one after
    another, each from its own. Without `carry` every cell starts from rest, or from its row of `states`
    (n, 6), in its own units. settle, observe: plate periods discarded and recorded. keep: flights stored.
    micro_flight: rad; shorter flights do not count for the mode, unless all are shorter.
    certify: whether a cell ends as soon as its cycle is certified, and is periodic only then; not with
    exponents, nor for a contact without variations.
    settle_until: most plate periods of a cell that still settles, of which the last `observe` are recorded;
    None: those of the window. With `certify` a cell takes first `params.periods_followed` more than the
    window, then all of them; without, their number is doubled as long as the cell settles.
    exponents: Lyapunov exponents to compute. in_lanes: False computes cell by cell even where lanes could,
    for comparison; the last digits differ.

    A trajectory that fails is an outcome, not an exception. Raises KernelInputError for arguments outside
    what a kernel can compute.
    """

    def __init__(
        self, gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64], *,
        plate: Any, carry: bool, settle: int, observe: int, keep: int, micro_flight: float = 0.0,
        settle_until: int | None = None, certify: bool = False, exponents: int = 0,
        start: Start | Sequence[Start | None] | None = None, states: NDArray[np.float64] | None = None,
        in_lanes: bool = True,
    ) -> None:  # fmt: skip
        arrays = {"gamma": gamma, "omega": omega, "xi": xi}
        check_arrays(arrays)
        _check_plate(plate, len(gamma))
        if certify and (exponents or dimension(plate) == 0):
            raise KernelInputError(
                "certify", "must be false with exponents, and for a contact that has no variations"
            )
        self.line = empty_line(len(gamma), keep, exponents)
        self._gamma, self._omega, self._xi = (np.ascontiguousarray(a) for a in arrays.values())
        self._plate, self._length = plate, 1
        self._states = np.empty((0, len(STATE_FIELDS)))
        if states is not None:
            self._states = checked_states(states, len(gamma))
        if carry:
            starts = [start] if start is None or isinstance(start, Start) else start
            self._states = _first_states(starts, self._gamma, self._omega)
            self._length = len(gamma) // len(starts)
        self._window = Window(
            int(settle), int(observe), float(micro_flight), int(settle_until or 0), bool(certify)
        )  # fmt: skip
        self._variations = lyapunov.allocate_variations(plate, exponents) if exponents else None
        in_lanes = in_lanes and type(plate) in advance_lanes.registry and self._variations is None
        self._lanes = _allocate_lanes(LANES if in_lanes else 1)
        self._flights = cell.allocate_flights(keep, len(self._lanes.index))
        self._search = self._attempt = None
        if self._variations is None and dimension(plate) > 0:  # one kernel, whether it certifies or not
            self._search = allocate_search(len(self._lanes.index) if certify else 0)
            self._attempt = allocate_attempt(self._flights)

    def advance(self, steps: int = _ALL) -> bool:
        """Compute on for about `steps` >= 1 contacts and flights; whether every cell of `line` is done."""
        return _walk(*self._arguments(steps))

    def is_compiled(self) -> bool:
        """Whether `advance` compiles nothing."""
        return is_compiled(_walk, *self._arguments(_ALL))

    def _arguments(self, steps: int) -> Any:
        return (
            self._plate, self._gamma, self._omega, self._xi, self._length, self._states, self._window,
            self.line, self._flights, self._lanes, self._lanes.table, self._variations, self._search,
            self._attempt, steps,
        )  # fmt: skip

    def save(self) -> dict[str, NDArray[Any]]:
        """All that `advance` changes, by name: the arrays themselves, not copies."""
        return {
            f"{type(part).__name__}.{name}": array
            for part in (self.line, self._flights, self._lanes, self._variations, self._search)
            if part is not None
            for name, array in part._asdict().items()
            if isinstance(array, np.ndarray)
        }

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Go on from what `save` gave for the same arguments. Raises ValueError for anything else."""
        arrays = self.save()
        for name, array in arrays.items():
            if name not in saved or (saved[name].shape, saved[name].dtype) != (array.shape, array.dtype):
                raise ValueError(f"{name}: must be as saved by a run of the same line")
        for name, array in arrays.items():
            array[...] = saved[name]


def run_line(
    gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64], **options: Any
) -> Line:
    """Run n cells in the given order and return their record. Arguments and errors as for `LineRun`."""
    run = LineRun(gamma, omega, xi, **options)
    run.advance()
    return run.line
