"""The trajectory of one cell at evenly spaced phases, as exact as the events.

Each sample is computed from the beginning of its contact or flight. Lengths are in plate amplitudes, which
is the paper's z omega**2/g divided by Gamma (Fig. 2). Plain Python that calls the compiled contact and
flight, fast enough for thousands of samples.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cell import BUDGET, SHORTEST_FLIGHT
from kernel.interface import contact, contact_force, flies, flight, prepare, rest
from kernel.numerics.elementary import TWO_PI, sincos
from kernel.numerics.first_root import HORIZON, ROOT, Phase
from kernel.params import Cell, KernelInputError
from kernel.validation import check_arrays

#: Contacts and flights computed at most, so that a call ends within seconds.
MAX_PHASES: Final = 50_000


class Trajectory(NamedTuple):
    """n samples of a trajectory, and the m flights that took off and landed within them."""

    phase: NDArray[np.float64]  # (n,) of the plate, rad, with whole periods added
    plate: NDArray[np.float64]  # (n,) cos(phase), plate amplitudes
    gap: NDArray[np.float64]  # (n,) lower mass above the plate
    elongation: NDArray[np.float64]  # (n,) spring length less its rest length
    force: NDArray[np.float64]  # (n,) of the plate on the lower mass, in m A omega**2
    in_flight: NDArray[np.bool_]  # (n,)
    takeoff: NDArray[np.float64]  # (m,) phase of the plate, rad, with whole periods as in `phase`
    flight_time: NDArray[np.float64]  # (m,) rad
    complete: bool  # whether it reached the end; samples beyond are NaN


class _Point(NamedTuple):
    """The state at the beginning of a contact or flight."""

    phase: float  # of the plate, rad modulo 2 pi, rounded as in `cell.record`
    period: int  # plate periods beside `phase`, 0 at the start
    in_flight: bool
    gap: float
    gap1: float
    q: float
    q1: float

    @property
    def at(self) -> float:
        """The plate's phase with its whole periods, rad."""
        return TWO_PI * self.period + self.phase


def sample(
    cell: Cell,
    plate: Any,
    state: NDArray[np.float64] | None,
    *,
    periods: int,
    samples: int,
) -> Trajectory:
    """The trajectory over `periods` plate periods from the state's phase, at `samples` instants in each.

    `plate`: made by a model's `plate` function for this one cell. `state` (6,): the initial state (see
    params.STATE_FIELDS), such as a cell's end state; None for rest at phase 0.
    Returns n = periods * samples + 1 samples. `stepped` is sampled at the nearest of its own steps.

    Raises KernelInputError as `line.run_line` does, and for a state that is not finite or whose phase is not
    in [0, 2 pi).
    """
    check_arrays({name: np.array([value], np.float64) for name, value in cell._asdict().items()})
    if state is not None and not (np.all(np.isfinite(state)) and 0.0 <= state[0] < TWO_PI):
        raise KernelInputError("state", f"must be finite, with a phase in [0, 2 pi); got {state}")
    spring = prepare(plate, 0, float(cell.gamma), float(cell.omega), float(cell.xi))
    begin = 0.0 if state is None else float(state[0])
    times = begin + np.arange(periods * samples + 1, dtype=np.float64) * (TWO_PI / samples)
    under_way = state is not None and state[1] != 0.0
    return _Walk(spring, times, periods).run(_begin(spring, state), under_way)


def _begin(spring: Any, state: NDArray[np.float64] | None) -> _Point:
    """The initial point, from a state (6,) or from rest."""
    gap, gap1, q, q1 = rest(spring) if state is None else (float(value) for value in state[2:])
    phase = 0.0 if state is None else float(state[0])
    return _Point(phase, 0, bool(flies(spring, phase, gap, gap1, q, q1)), gap, gap1, q, q1)


def _after(here: _Point, p: Phase) -> _Point:
    """The beginning of the phase that follows `p`, which began `here`."""
    turns = math.floor((here.phase + p.tau) / TWO_PI)
    phase = here.phase + p.tau - TWO_PI * turns
    return _Point(phase, here.period + turns, p.in_flight, p.gap, p.gap1, p.q, p.q1)


class _Walk:
    """Computes a trajectory phase by phase and fills in the samples of each."""

    def __init__(self, spring: Any, times: NDArray[np.float64], periods: int) -> None:
        self._spring, self._times, self._periods = spring, times, periods
        self._budget = BUDGET * periods
        self._phases = MAX_PHASES
        self._gap, self._q, self._n = (np.full(len(times), np.nan) for _ in range(3))
        self._flies = np.zeros(len(times), np.bool_)
        self._flights: list[tuple[float, float]] = []
        self._next = 0  # the first sample not filled in yet

    def run(self, here: _Point, under_way: bool) -> Trajectory:
        """The trajectory from `here` to the last sample.

        under_way: whether a flight began before the first sample; it is not counted.
        """
        end = float(self._times[-1])
        flew_in = here.in_flight and under_way
        while self._next < len(self._times):
            p = self._phase(here, end - here.at)
            self._fill(here, p.tau, reached_end=p.ending == HORIZON)
            if here.in_flight and not flew_in and p.ending == ROOT and p.tau > SHORTEST_FLIGHT:
                self._flights.append((here.at, p.tau))
            flew_in = flew_in and p.ending != ROOT
            self._budget -= p.used
            self._phases -= 1
            if p.ending != ROOT or min(self._budget, self._phases) <= 0:
                break
            here = _after(here, p)
        return self._trajectory()

    def _phase(self, here: _Point, horizon: float) -> Phase:
        """The contact or flight that begins `here`, cut off `horizon` rad later."""
        run = flight if here.in_flight else contact
        phase: Phase = run(
            self._spring, here.phase, here.gap, here.gap1, here.q, here.q1, max(horizon, 0.0), self._budget
        )
        return phase

    def _fill(self, here: _Point, tau: float, *, reached_end: bool) -> None:
        """Fill in the samples within a phase that begins `here` and lasts `tau` rad."""
        last = len(self._times) if reached_end else int(np.searchsorted(self._times, here.at + tau, "left"))
        for i in range(self._next, last):
            x: Any = here
            if self._times[i] > here.at:
                x = self._phase(here, float(self._times[i]) - here.at)
            self._gap[i], self._q[i], self._flies[i] = x.gap, x.q, here.in_flight
            if here.in_flight:
                self._n[i] = 0.0
            else:
                _, cos = sincos(self._times[i])
                self._n[i] = contact_force(self._spring, cos, x.gap, x.gap1, x.q, x.q1)
        self._next = max(self._next, last)

    def _trajectory(self) -> Trajectory:
        """The samples filled in so far, with NaN for the rest."""
        flights = np.array(self._flights, np.float64).reshape(-1, 2)
        return Trajectory(
            self._times,
            np.array([sincos(time)[1] for time in self._times]),
            self._gap,
            self._q,
            self._n,
            self._flies,
            flights[:, 0],
            flights[:, 1],
            self._next == len(self._times),
        )
