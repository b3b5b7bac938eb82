"""The functions a contact model implements, chosen at compile time by the type of their first argument.

A model has a *plate*, the contact under each cell of a line, and a *cell*, the constants of one cell. Its
module has a function `plate`, which makes the former from checked arrays (n,), and registers the functions
below. Times are in rad from the start of a contact or flight; a horizon is the time at which it is cut off, a
budget the number of evaluations of a phase function it may use.
"""

import math
from typing import Any, NamedTuple

from kernel.numerics.elementary import sincos
from kernel.numerics.jit import by_type, inlined, jit


class PlatePhase(NamedTuple):
    """The plate's phase phi, with its sine and cosine."""

    rad: float
    sin: float
    cos: float


@inlined
def plate_phase(rad: float) -> PlatePhase:
    """The plate's phase at this angle."""
    sin, cos = sincos(rad)
    return PlatePhase(rad, sin, cos)


class State(NamedTuple):
    """Where the spring is, relative to the plate, in plate amplitudes and plate amplitudes per rad."""

    gap: float  # of the lower mass above the plate
    gap1: float
    q: float  # the elongation
    q1: float


class Phase(NamedTuple):
    """The end of one contact or flight."""

    tau: float  # rad since it began
    ending: int  # first_root.ROOT, HORIZON, BUDGET_EXHAUSTED or NON_FINITE
    in_flight: bool  # whether the next phase is a flight
    state: State
    used: int  # evaluations


@by_type
def prepare(plate: Any, i: int, gamma: float, omega: float, xi: float) -> Any:
    """The constants of the i-th cell of a line."""


@by_type
def rest(cell: Any) -> State:  # type: ignore[empty-body]
    """The state of a spring at rest on the plate at phase zero."""


@by_type
def relative_margin(cell: Any) -> float:  # type: ignore[empty-body]
    """The least force of the plate on a spring whose free motion has decayed, over the mean force.

    NaN for a contact that does not tell.
    """


@relative_margin.register(object)
@inlined
def _no_free_motion(cell: Any) -> float:
    return math.nan


@by_type
def flies(cell: Any, phi: PlatePhase, state: State) -> bool:  # type: ignore[empty-body]
    """Whether a phase that begins with this state is a flight."""


@by_type
def contact(  # type: ignore[empty-body]
    cell: Any, phi: PlatePhase, state: State, horizon: float, budget: int
) -> Phase:  # fmt: skip
    """The contact that begins with this state, to its take-off or to the horizon."""


@by_type
def flight(  # type: ignore[empty-body]
    cell: Any, phi: PlatePhase, state: State, horizon: float, budget: int
) -> Phase:  # fmt: skip
    """The flight that begins with this state, to after its landing or to the horizon."""


@jit
def phase_of(cell: Any, phi: PlatePhase, run: Any, horizon: float) -> Phase:
    """The contact or flight that follows a run (`cell.Progress`), to its end or to the horizon."""
    p: Phase
    if run.in_flight:
        p = flight(cell, phi, run.state, horizon, run.budget)
    else:
        p = contact(cell, phi, run.state, horizon, run.budget)
    return p


@by_type
def contact_force(cell: Any, phi: PlatePhase, state: State) -> float:  # type: ignore[empty-body]
    """The plate's force n on the lower mass in contact, in m A omega**2."""


@by_type
def replay(cell: Any, run: Any, window: Any, flights: Any, cache: Any) -> Any:
    """A run (`cell.Progress`) at a take-off from rest, advanced through phases known from earlier ones.

    `cache` (CACHE_SIZE,), the cell's, is zero when it begins. The default returns the run as it is.
    """


@replay.register(object)
@jit
def _no_replay(cell: Any, run: Any, window: Any, flights: Any, cache: Any) -> Any:
    return run


# Lanes: phases of many runs (`cell.Progress`) side by side, in a table of `kernel.models.lanes`. A model
# without these is computed cell by cell.


@by_type
def advance_lanes(plate: Any, table: Any, used: int) -> None:
    """Evaluate the phase functions of the first `used` lanes once and move their searches on."""


@by_type
def load_lane(cell: Any, table: Any, k: int, run: Any, phi: PlatePhase, horizon: float) -> bool:  # type: ignore[empty-body]
    """Put the run's next phase into lane k, if lanes can compute it."""


@by_type
def unload_lane(cell: Any, table: Any, k: int, run: Any) -> tuple[Phase, PlatePhase]:  # type: ignore[empty-body]
    """The run's phase, which has ended in lane k, and the plate's phase there."""


# Variations: how small differences of the state at a fixed phase, `vectors` (n, 4) of (gap, gap', q, q'),
# move through contacts, flights and events (docs/model.md, section 7). They are overwritten.


@by_type
def landing_error(cell: Any, phi: PlatePhase, state: State, tau: float) -> float:  # type: ignore[empty-body]
    """How far rounding may move the landing, at tau, of the flight that begins with this state, in rad."""


@by_type
def dimension(plate: Any) -> int:  # type: ignore[empty-body]
    """The number of exponents: the dimension of a state at a fixed phase; 0 without variations."""


@dimension.register(object)
def _no_variations(plate: Any) -> int:
    return 0


@by_type
def carry_in_contact(cell: Any, vectors: Any, tau: float) -> None:
    """Carry `vectors` over tau > 0 rad of a contact."""


@by_type
def carry_in_flight(cell: Any, vectors: Any, tau: float) -> None:
    """Carry `vectors` over tau > 0 rad of a flight."""


@by_type
def carry_through_takeoff(cell: Any, vectors: Any, end: Phase) -> None:
    """Carry `vectors` from the end of the contact `end` to the flight that begins there."""


@by_type
def carry_through_landing(cell: Any, vectors: Any, phi: PlatePhase, state: State, end: Phase) -> None:
    """Carry `vectors` through the landing of the flight `end`, which began with `state` at phi."""
