"""The kernel's inputs, their checks, and its records, shared by the whole project.

Nothing here needs numba, so that the specification, the service and the client can import it without
compiling anything.

Units throughout: phase phi = omega*t in rad, lengths in plate amplitudes A,
velocities in A per rad of phase, forces in m*A*omega**2.
"""

from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Part of every job's identity: raise it whenever any stored number may change.
KERNEL_VERSION: Final = "16"

#: Cells that `rigid` and `soft` compute side by side, in lanes: two vectors of eight doubles, so that the
#: latency of one hides behind the other.
LANES: Final = 16

#: Evaluations that a cell may use for each plate period, and those that are usual.
BUDGET: Final = 20_000
USUAL_EVALUATIONS: Final = 11

#: A cell whose window shows no mode is followed for FOLLOW times its `observe`, at most MOST_FOLLOWED plate
#: periods, before it is called aperiodic or settling: only time reveals a chaotic transient.
FOLLOW: Final = 2
MOST_FOLLOWED: Final = 200


def periods_followed(observe: int) -> int:
    """Plate periods for which a cell without a mode is followed beyond a window of `observe` periods."""
    return min(FOLLOW * observe, MOST_FOLLOWED)


class Cell(NamedTuple):
    """One point of parameter space."""

    gamma: float  # plate acceleration A*omega**2/g
    omega: float  # plate frequency over the spring's natural frequency
    xi: float  # damping ratio of the spring


class Outcome(IntEnum):
    """How a cell ended. A failed trajectory is data, not an error."""

    MISSING = 0  # not computed yet
    PERIODIC = 1  # the flights repeat
    APERIODIC = 2  # they neither repeat nor settle
    AT_REST = 3  # in contact throughout the window
    UNRESOLVED = 4  # the budget of evaluations ran out, or the flights kept are too few to tell
    DIVERGED = 5  # a number stopped being finite
    SETTLING = 6  # they do not yet: they still drift towards something


class KernelInputError(ValueError):
    """An argument outside what a kernel can compute; names the argument and the rule it breaks."""

    def __init__(self, argument: str, rule: str) -> None:
        super().__init__(argument, rule)  # both, so that it can be pickled and sent from a worker
        self.argument = argument
        self.rule = rule

    def __str__(self) -> str:
        return f"{self.argument}: {self.rule}"


#: The state a ramp carries from cell to cell, in the order of `Line.end_state`. Lengths in plate amplitudes.
STATE_FIELDS: Final = (
    "phase",  # rad, modulo 2*pi
    "in_flight",  # 1.0 in flight, 0.0 in contact
    "gap",  # lower mass above the plate; 0 in a rigid contact, negative in a soft one
    "gap_velocity",
    "elongation",  # spring length less its rest length
    "elongation_velocity",
)


#: Dimensions of a state at a fixed phase of the plate, and so the largest numbers of Lyapunov exponents: of a
#: spring; of one that always leaves an ideal plate at the plate's velocity (e = 0); of a ball.
SPRING_DIMENSION: Final = 4
INELASTIC_DIMENSION: Final = 3
BALL_DIMENSION: Final = 2

#: Most Lyapunov exponents of a cell.
MAX_EXPONENTS: Final = SPRING_DIMENSION


class Start(NamedTuple):
    """A state to continue from, with the cell whose plate amplitude its lengths are measured in."""

    state: NDArray[np.float64]  # (len(STATE_FIELDS),)
    cell: Cell


class Line(NamedTuple):
    """The record of n cells in the order they were computed."""

    flight_time: NDArray[np.float64]  # (n, keep) rad; the last `keep` flights, NaN beyond `flights`
    takeoff_phase: NDArray[np.float64]  # (n, keep) rad, modulo 2*pi
    flights: NDArray[np.int32]  # (n,) flights that took off and landed inside the window
    outcome: NDArray[np.uint8]  # (n,) an Outcome
    bounces: NDArray[np.int32]  # (n,) flights per cycle that count, 0 if none was found
    periods: NDArray[np.int32]  # (n,) plate periods per cycle
    end_state: NDArray[np.float64]  # (n, len(STATE_FIELDS)) at the end of each cell's window
    lyapunov: NDArray[np.float64]  # (n, exponents) per plate period, natural logarithm, the largest first
    lyapunov_error: NDArray[np.float64]  # (n,) standard error of the first of them, NaN where it has none
    # of certified cells, else NaN:
    flight_error: NDArray[np.float64]  # (n,) rad; a bound on the error of each flight time and take-off phase
    multiplier: NDArray[np.float64]  # (n,) modulus of the cycle's leading Floquet multiplier
    multiplier_angle: NDArray[np.float64]  # (n,) its angle, rad from 0 to pi


def empty_line(n: int, keep: int, exponents: int = 0) -> Line:
    """The record of n cells that have not been run, with room for `keep` flights and `exponents` of each."""
    return Line(
        flight_time=np.full((n, keep), np.nan),
        takeoff_phase=np.full((n, keep), np.nan),
        flights=np.zeros(n, np.int32),
        outcome=np.zeros(n, np.uint8),
        bounces=np.zeros(n, np.int32),
        periods=np.zeros(n, np.int32),
        end_state=np.full((n, len(STATE_FIELDS)), np.nan),
        lyapunov=np.full((n, exponents), np.nan),
        lyapunov_error=np.full(n, np.nan),
        flight_error=np.full(n, np.nan),
        multiplier=np.full(n, np.nan),
        multiplier_angle=np.full(n, np.nan),
    )


def counted_flights(
    line: Line, i: int, micro_flight: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times and take-off phases of cell i's stored flights that count: those above `micro_flight`, or all."""
    stored = np.isfinite(line.flight_time[i])
    longer = stored & (line.flight_time[i] > micro_flight)
    rows = longer if longer.any() else stored
    return line.flight_time[i][rows], line.takeoff_phase[i][rows]


#: Parameters must lie within this and its inverse. Their squares, such as 1/d^2, then stay within 1e60, and
#: products of four of those, which the kernels form, within a double's range of 1e308.
LARGEST: Final = 1e30


def check_arrays(arrays: dict[str, NDArray[np.float64]]) -> None:
    """Check float64 arrays (n,) of one length, by name, each within its rule. Raises KernelInputError."""
    shape = None
    for name, array in arrays.items():
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        if kind != np.float64:
            raise KernelInputError(name, f"must be a float64 array, got {kind}")
        if array.ndim != 1 or len(array) == 0:
            raise KernelInputError(name, f"must have shape (n,) with n >= 1, got {array.shape}")
        shape = shape or array.shape
        if array.shape != shape:
            raise KernelInputError(name, f"must have the shape of gamma, {shape}, got {array.shape}")
        low, high, rule = 1.0 / LARGEST, LARGEST, "must lie within 1e-30 and 1e30"
        if name == "restitution":  # which the models limit themselves
            low, high, rule = 0.0, 1.0, "must lie in [0, 1]"
        allowed = (low <= array) & (array <= high)
        if name == "xi":
            allowed, rule = allowed | (array == 0.0), f"{rule}, or be 0"
        if not allowed.all():
            i = np.argmin(allowed)
            raise KernelInputError(name, f"{rule}, got {array[i]} at index {i}")


def checked_states(states: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """The states (n, len(STATE_FIELDS)) that n cells start from. Raises KernelInputError."""
    array = np.ascontiguousarray(states, dtype=np.float64)
    if array.shape != (n, len(STATE_FIELDS)) or not np.all(np.isfinite(array)):
        rule = f"must hold {len(STATE_FIELDS)} finite numbers for each of {n} cells"
        raise KernelInputError("states", f"{rule}: {', '.join(STATE_FIELDS)}")
    if not np.all((array[:, 0] >= 0.0) & (array[:, 0] < 2.0 * np.pi)):
        raise KernelInputError("states", "must have phases from 0 to 2 pi")
    return array
