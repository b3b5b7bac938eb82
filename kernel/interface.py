"""What a contact model answers. Each model registers its own functions, chosen by type.

A model has a *plate*, the contact under each cell of a line, and a *cell*, one cell's
constants. Its module has a function `plate`, which makes the former from checked arrays (n,).
A state is (gap, gap', q, q'): the lower mass above the plate and the elongation with their
velocities; phi is the plate's phase. Times are rad from the start of a phase.
"""

from typing import Any

from kernel.numerics.first_root import Phase
from kernel.numerics.jit import by_type, jit


@by_type
def prepare(plate: Any, i: int, gamma: float, omega: float, xi: float) -> Any:
    """The constants of the i-th cell of a line."""


@by_type
def rest(cell: Any) -> tuple[float, float, float, float]:  # type: ignore[empty-body]
    """The state of a spring at rest on the plate at phase zero."""


@by_type
def flies(cell: Any, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:  # type: ignore[empty-body]
    """Whether this state is a flight."""


@by_type
def contact(  # type: ignore[empty-body]
    cell: Any, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """In contact until take-off, or to the horizon."""


@by_type
def flight(  # type: ignore[empty-body]
    cell: Any, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """In flight until landing, or to the horizon."""


@by_type
def contact_force(cell: Any, cos: float, gap: float, gap1: float, q: float, q1: float) -> float:  # type: ignore[empty-body]
    """The plate's force on the lower mass in contact, in m A omega**2; `cos` is of the plate's phase."""


@by_type
def repeat(cell: Any, run: Any, window: Any, flights: Any, memory: Any) -> Any:
    """A run (trajectory.Progress) at a take-off from rest, moved on over all that always follows one.

    `memory` (MEMORY,) is the cell's own, zeros when it begins.
    """


@repeat.otherwise
@jit
def _nothing_repeats(cell: Any, run: Any, window: Any, flights: Any, memory: Any) -> Any:
    return run
