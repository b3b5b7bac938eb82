"""A line of cells, from arrays of parameters to arrays of records: the entry to the kernels.

Under the protocol `rest` every cell starts from rest at its own parameters, in a basin from a state of its
own. A ramp carries the state over from cell to cell: the physical motion is kept, and since A is proportional
to Gamma/Omega**2, lengths in plate amplitudes scale by (Gamma_old/Gamma_new)(Omega_new/Omega_old)**2 and
velocities by (Gamma_old/Gamma_new)(Omega_new/Omega_old) (docs/model.md, section 4).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cell import (
    CACHE_SIZE,
    RUN_FIELDS,
    Flights,
    Window,
    allocate_flights,
    begin_line,
    begin_next,
    decide,
    extend,
    follow,
    load_run,
    rescale,
    run_cell,
    shows_no_mode,
    store_run,
    store_state,
    write_record,
)
from kernel.exponents import (
    Variations,
    allocate_variations,
    begin_window,
    exponent_error,
    start_variations,
    write_exponents,
)
from kernel.interface import advance_lanes, prepare
from kernel.models import rigid_lanes as _rigid_lanes  # noqa: F401 - registers the model's lanes
from kernel.models import soft_lanes as _soft_lanes  # noqa: F401 - registers the model's lanes
from kernel.models import variations as _variations  # noqa: F401 - registers the models' variations
from kernel.models.lockstep import Lanes, allocate_lanes, run_lockstep
from kernel.numerics.first_root import ROOT
from kernel.numerics.jit import allocating
from kernel.params import LANES, STATE_FIELDS, KernelInputError, Line, Start, empty_line
from kernel.validation import check_arrays, check_early, check_window, checked_state, checked_states

#: More steps than any line takes.
_ALL: Final = 2**62

#: Stages of a cell.
NOT_BEGUN: Final = 0
IN_WINDOW: Final = 1  # or before it
FOLLOWED: Final = 2  # beyond its window


class Walk(NamedTuple):
    """Where lines are that are computed cell by cell."""

    counts: Any  # (2,) int64: cells done; stage of the cell under way
    run: Any  # (RUN_FIELDS,) the run of the cell under way, or of the last one
    end: Any  # (RUN_FIELDS,) while it is followed, the run at its window's end
    cache: Any  # (CACHE_SIZE,) its model's


def _allocate_walk() -> Walk:
    """At the first cell."""
    return Walk(np.zeros(2, np.int64), np.zeros(RUN_FIELDS), np.zeros(RUN_FIELDS), np.zeros(CACHE_SIZE))


@allocating
def _walk(
    plate: Any, gamma: Any, omega: Any, xi: Any, length: int, states: Any, window: Window, line: Line,
    flights: Flights, walk: Walk, variations: Variations | None, steps: int,
) -> bool:  # fmt: skip
    """Run lines of `length` cells, cell by cell, for `steps` contacts and flights; whether all is done.

    `states`: (n / length, 6) where each line begins, as in `cell.begin_line`. Fills `line`. The next call
    goes on from `flights`, `walk` and `variations`, which are overwritten. `variations`: for the exponents,
    or None.
    """
    counts, state = walk.counts, np.zeros(len(STATE_FIELDS))
    while counts[0] < len(gamma):
        i = counts[0]
        cell = prepare(plate, i, gamma[i], omega[i], xi[i])
        run = load_run(walk.run)
        if counts[1] == NOT_BEGUN:
            if i % length == 0:
                run = begin_line(cell, states, i // length, state, window)
            else:
                run = begin_next(
                    cell, run, gamma[i - 1], omega[i - 1], gamma[i], omega[i], state, window
                )  # fmt: skip
            if variations is not None:
                start_variations(variations)
            walk.cache[:] = 0.0
            counts[1] = IN_WINDOW
        if counts[1] == FOLLOWED:
            _, run, steps = run_cell(cell, run, window, flights, walk.cache, None, steps)
            if run.ending != ROOT:
                line.outcome[i] = decide(line.outcome[i], run, flights, 0, window)
                run = load_run(walk.end)
        else:
            last, run, steps = run_cell(cell, run, window, flights, walk.cache, variations, steps)
            if run.ending != ROOT:
                if variations is not None:
                    write_exponents(line.lyapunov[i], run.ending, variations)
                    line.lyapunov_error[i] = exponent_error(run.ending, variations, window.observe)
                store_state(run, state)
                write_record(line, i, run, flights, 0, state, window)
                if shows_no_mode(line.outcome[i]):
                    store_run(run, walk.end)
                    run = follow(last, window)
                    walk.cache[:] = 0.0
                    counts[1] = FOLLOWED
        if run.ending != ROOT:
            run = extend(run, line.outcome[i], window)
            if run.ending == ROOT:
                if variations is not None:
                    begin_window(variations)
                walk.cache[:] = 0.0
                counts[1] = IN_WINDOW
        store_run(run, walk.run)
        if run.ending != ROOT:
            counts[0] += 1
            counts[1] = NOT_BEGUN
        elif steps <= 0:
            return False
    return True


def _check_plate(plate: Any, n: int) -> None:
    """Check that a model's `plate` function made this, for n cells. Raises KernelInputError."""
    if type(plate) not in prepare:
        raise KernelInputError("plate", f"must be made by a model's `plate`, not a {type(plate).__name__}")
    for name, array in plate._asdict().items():
        if isinstance(array, np.ndarray) and array.shape != (n,):
            raise KernelInputError(name, f"must have the shape of gamma, ({n},), got {array.shape}")


def _first_states(
    starts: Sequence[Start | None], gamma: NDArray[np.float64], omega: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where each of as many lines begins, (lines, len(STATE_FIELDS)) in its first cell's units; NaN: at rest.

    Raises KernelInputError.
    """
    if not starts or len(gamma) % len(starts):
        rule = (
            f"must be one for each of several lines of equal length, got {len(starts)} for {len(gamma)} cells"
        )
        raise KernelInputError("start", rule)
    states = np.full((len(starts), len(STATE_FIELDS)), np.nan)
    for number, start in enumerate(starts):
        if start is not None:
            states[number] = checked_state(start)
            first = number * (len(gamma) // len(starts))
            rescale(states[number], start.cell.gamma, start.cell.omega, gamma[first], omega[first])
    return states


class LineRun:
    """A line of cells under way: computed in parts, its state saved between them and restored elsewhere.

    However it is divided, the numbers are the same.

    gamma, omega, xi: float64 (n,). plate: made by a model's `plate` function from its own arrays (n,); its
    type selects the model. With `carry` each cell continues from its predecessor's end, the first from
    `start` or from rest (None). A sequence of starts makes the cells as many lines of equal length, one after
    another, each from its own. Without `carry` every cell starts from rest, or from its row of `states`
    (n, 6), in its own units. settle, observe: plate periods discarded and recorded. keep: flights stored.
    micro_flight: rad; shorter flights do not count for the mode, unless all are. settle_tolerance: rad; if
    > 0, flights that repeat within it end the settling early. settle_until: plate periods that a cell still
    settling may take in all; None: no more than the window.
    The periods are doubled as long as the cell settles, and the last `observe` of them are recorded.
    settle_early: whether the cycles that are left are not computed but repeated, once the last flights surely
    follow one (`kernel.repetition`); not with `carry` or `exponents`.
    exponents: Lyapunov exponents to compute. in_lanes: False computes cell by cell also where lanes could,
    for comparison; the last digits differ.

    A trajectory that fails is an outcome, not an exception. Raises KernelInputError for arguments outside
    what a kernel can compute.
    """

    def __init__(
        self,
        gamma: NDArray[np.float64],
        omega: NDArray[np.float64],
        xi: NDArray[np.float64],
        *,
        plate: Any,
        carry: bool,
        settle: int,
        observe: int,
        keep: int,
        micro_flight: float = 0.0,
        settle_tolerance: float = 0.0,
        settle_until: int | None = None,
        settle_early: bool = False,
        exponents: int = 0,
        start: Start | Sequence[Start | None] | None = None,
        states: NDArray[np.float64] | None = None,
        in_lanes: bool = True,
    ) -> None:
        arrays = {"gamma": gamma, "omega": omega, "xi": xi}
        check_arrays(arrays)
        check_window(settle, observe, keep, micro_flight, settle_tolerance, settle_until, exponents)
        check_early(settle_early, carry=carry, exponents=exponents)
        _check_plate(plate, len(gamma))
        self.line = empty_line(len(gamma), keep, exponents)
        self._gamma, self._omega, self._xi = (np.ascontiguousarray(a) for a in arrays.values())
        self._plate, self._length = plate, 1
        self._states = checked_states(states, len(gamma), carry=carry)
        if carry:
            starts = [start] if start is None or isinstance(start, Start) else start
            self._states = _first_states(starts, self._gamma, self._omega)
            self._length = len(gamma) // len(starts)
        self._window = Window(
            int(settle), int(observe), float(micro_flight), float(settle_tolerance),
            int(settle_until or 0), int(exponents), bool(settle_early),
        )  # fmt: skip
        self._variations = allocate_variations(plate, exponents) if exponents else None
        in_lanes = in_lanes and type(plate) in advance_lanes and self._variations is None
        self._at: Lanes | Walk = allocate_lanes() if in_lanes else _allocate_walk()
        self._flights = allocate_flights(keep, LANES if in_lanes else 1)

    def advance(self, steps: int = _ALL) -> bool:
        """Compute on for about `steps` >= 1 contacts and flights; whether every cell of `line` is done."""
        if isinstance(self._at, Lanes):
            return run_lockstep(
                self._plate, self._gamma, self._omega, self._xi, self._length, self._states, self._window,
                self.line, self._flights, self._at, steps,
            )  # fmt: skip
        return _walk(
            self._plate, self._gamma, self._omega, self._xi, self._length, self._states, self._window,
            self.line, self._flights, self._at, self._variations, steps,
        )  # fmt: skip

    def save(self) -> dict[str, NDArray[Any]]:
        """All that `advance` changes, by name: the arrays themselves, not copies."""
        return {
            f"{type(part).__name__}.{name}": array
            for part in (self.line, self._flights, self._at, self._variations)
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
    """Run n cells in the given order and return their record. Arguments and errors as of `LineRun`."""
    run = LineRun(gamma, omega, xi, **options)
    run.advance()
    return run.line
