"""The trajectory of one cell at evenly spaced phases, as exact as the events.

Each sample is computed from the beginning of its contact or flight. Lengths are in plate amplitudes, which
is the paper's z omega**2/g divided by Gamma (Fig. 2). Plain Python that calls the compiled contact and
flight, fast enough for thousands of samples.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cell import SHORTEST_FLIGHT
from kernel.interface import Phase, State, contact, contact_force, flies, flight, plate_phase, prepare, rest
from kernel.numerics.elementary import TWO_PI, sincos
from kernel.numerics.first_root import HORIZON, ROOT
from kernel.params import BUDGET, Cell, KernelInputError, check_arrays

MAX_PHASES: Final = 50_000  # most contacts and flights that a call computes, so that it ends within seconds


class Trajectory(NamedTuple):
    """n samples of a trajectory, and the m flights that took off and landed within them."""

    phase: NDArray[np.float64]  # (n,) of the plate, rad, with whole periods added
    plate: NDArray[np.float64]  # (n,) cos(phase), plate amplitudes
    gap: NDArray[np.float64]  # (n,) lower mass above the plate
    elongation: NDArray[np.float64]  # (n,) spring length less its rest length
    velocity: NDArray[np.float64]  # (n,) of the elongation, plate amplitudes per rad
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
    state: State

    @property
    def time(self) -> float:
        """The plate's phase with its whole periods, rad."""
        return TWO_PI * self.period + self.phase

    def until(self, spring: Any, time: float, budget: int) -> Phase:
        """The contact or flight that begins here, cut off at this time."""
        run = flight if self.in_flight else contact
        phase: Phase = run(spring, plate_phase(self.phase), self.state, max(time - self.time, 0.0), budget)
        return phase

    def after(self, p: Phase) -> "_Point":
        """The beginning of the phase that follows `p`, which begins here."""
        turns = math.floor((self.phase + p.tau) / TWO_PI)
        phase = self.phase + p.tau - TWO_PI * turns
        return _Point(phase, self.period + turns, p.in_flight, p.state)


def sample(
    cell: Cell, plate: Any, state: NDArray[np.float64] | None, *, periods: int, samples: int
) -> Trajectory:
    """The trajectory over `periods` plate periods from the state's phase, at `samples` instants in each.

    `plate`: made by a model's `plate` function for this one cell. `state` (6,): the initial state (see
    params.STATE_FIELDS), such as a cell's end state; None for rest at phase 0.
    Returns n = periods * samples + 1 samples. `stepped` is sampled at the nearest of its own steps.

    Raises KernelInputError as `params.check_arrays` does, and for a state that is not finite or whose phase
    is not in [0, 2 pi).
    """
    check_arrays({name: np.array([value], np.float64) for name, value in cell._asdict().items()})
    if state is not None and not (np.all(np.isfinite(state)) and 0.0 <= state[0] < TWO_PI):
        raise KernelInputError("state", f"must be finite, with a phase in [0, 2 pi); got {state}")
    spring = prepare(plate, 0, float(cell.gamma), float(cell.omega), float(cell.xi))
    begin = 0.0 if state is None else float(state[0])
    times = begin + np.arange(periods * samples + 1, dtype=np.float64) * (TWO_PI / samples)
    first = rest(spring) if state is None else State(*map(float, state[2:]))
    here = _Point(begin, 0, bool(flies(spring, plate_phase(begin), first)), first)
    # a flight from before is not counted
    under_way = here.in_flight and state is not None and state[1] != 0.0
    points = np.full((4, len(times)), np.nan)
    in_flight = np.zeros(len(times), np.bool_)
    flights: list[tuple[float, float]] = []
    filled, budget = 0, BUDGET * periods
    for _ in range(MAX_PHASES):
        p = here.until(spring, float(times[-1]), budget)
        last = len(times) if p.ending == HORIZON else int(np.searchsorted(times, here.time + p.tau, "left"))
        for i in range(filled, last):
            points[:, i] = _sampled(spring, here, float(times[i]), budget)
            in_flight[i] = here.in_flight
        filled = max(filled, last)
        if here.in_flight and not under_way and p.ending == ROOT and p.tau > SHORTEST_FLIGHT:
            flights.append((here.time, p.tau))
        budget -= p.used
        if p.ending != ROOT or budget <= 0 or filled == len(times):
            break
        here, under_way = here.after(p), False
    takeoff, flight_time = np.array(flights, np.float64).reshape(-1, 2).T
    cosines = np.array([sincos(time)[1] for time in times])
    gaps, elongations, velocities, forces = points
    return Trajectory(
        times, cosines, gaps, elongations, velocities, forces, in_flight, takeoff, flight_time,
        filled == len(times),
    )  # fmt: skip


def _sampled(spring: Any, here: _Point, time: float, budget: int) -> tuple[float, float, float, float]:
    """Gap, elongation, its velocity, and force at `time` within the phase that begins `here`."""
    state = here.until(spring, time, budget).state if time > here.time else here.state
    force = 0.0 if here.in_flight else contact_force(spring, plate_phase(time), state)
    return state.gap, state.q, state.q1, force
