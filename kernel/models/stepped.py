"""The soft plate by fixed time steps: the molecular dynamics of the paper (section 2.2, MODEL section 2).

The contact is that of `kernel.models.soft`, gap'' = b q' + w q - 1/Gamma + cos(phi) - kappa gap - beta gap'
while it lasts, moved on by one of the schemes of `kernel.models.time_stepping`. A step of h = 2 pi/N rad,
at most the contact's duration over `steps_per_contact` (`kernel.step_limits`), takes a whole number N of
steps to the plate period, and the grid of phases on which steps end is the same in every period.

The spring takes off or lands inside a step. That step is shortened so that it ends there (the
zero of the same scheme's own gap or force), and another shortened one leads back to the grid.
Without it the force would set in late by up to h, and both schemes would be of first order.
Only what the steps' ends show is seen: a touch or a hop shorter than a step may be passed over,
and one that ends before the first point of the grid ends there.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import contact, contact_force, flies, flight, prepare, rest
from kernel.models.contact_law import lets_go
from kernel.models.time_stepping import Grid, Law, March, Point, before, law, march, outset, over, step
from kernel.modes import TWO_PI
from kernel.numerics.first_root import BUDGET_EXHAUSTED, EPS, HORIZON, NON_FINITE, ROOT, Phase
from kernel.numerics.jit import jit
from kernel.params import KernelInputError
from kernel.restitution import damping_ratio
from kernel.step_limits import MOST_STEPS_PER_PERIOD, Scheme, steps_per_period
from kernel.validation import check_arrays

#: Steps between two exact evaluations of the plate's phase; in between a rotation turns it on.
BLOCK: Final = 1024

#: Where less than this part of a step is left to the next point of the grid, that point is skipped.
SLIVER: Final = 1e-9

#: A gap or elongation beyond this, in plate amplitudes, is that of a scheme that has blown up.
LARGEST: Final = 1e30

#: Rounds of regula falsi for the end of a contact or flight; it needs a handful.
ROUNDS: Final = 60


class SteppedPlate(NamedTuple):
    """The plate under each cell of a line."""

    damping: NDArray[np.float64]  # (n,) zeta
    penetration: NDArray[np.float64]  # (n,) d, plate amplitudes
    steps: NDArray[np.int64]  # (n,) to the plate period
    adhesive: bool
    implicit: float  # 1/2 for velocity Verlet, 0 for semi-implicit Euler


class SteppedSpring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    grid: Grid
    contact: Law
    flight: Law
    sag: float  # static elongation
    dent: float  # static gap, < 0


def plate(
    *,
    restitution: NDArray[np.float64],
    penetration: NDArray[np.float64],
    adhesive: bool,
    steps_per_contact: int,
    scheme: str,
) -> SteppedPlate:
    """The plate under n cells; restitution (n,) in [0, 1], penetration (n,) > 0 in plate amplitudes.

    Raises KernelInputError, also for a scheme there is not and for what is no number of steps.
    """
    check_arrays({"restitution": restitution, "penetration": penetration})
    names = [s.name.lower() for s in Scheme]
    if scheme not in names:
        raise KernelInputError("scheme", f"must be one of {', '.join(names)}, got {scheme!r}")
    whole = isinstance(steps_per_contact, int | np.integer) and not isinstance(steps_per_contact, bool)
    if not whole or steps_per_contact < 1:
        raise KernelInputError("steps_per_contact", f"must be an integer >= 1, got {steps_per_contact!r}")
    damping = damping_ratio(restitution, adhesive)
    steps = steps_per_period(restitution, penetration, int(steps_per_contact), adhesive=adhesive)
    return SteppedPlate(
        damping, np.ascontiguousarray(penetration), steps, bool(adhesive), 0.5 if scheme == "verlet" else 0.0
    )


@contact_force.register(SteppedSpring)
@jit
def _contact_force(s: SteppedSpring, cos: float, gap: float, gap1: float, q: float, q1: float) -> float:
    return -(s.contact.kappa * gap + s.contact.beta * gap1)


@prepare.register(SteppedPlate)
@jit
def _prepare(plate: SteppedPlate, i: int, gamma: float, omega: float, xi: float) -> SteppedSpring:
    d = plate.penetration[i]
    w, b, kappa, beta = 1.0 / (omega * omega), 2.0 * xi / omega, 1.0 / (d * d), 2.0 * plate.damping[i] / d
    lead = 0.0 if plate.adhesive else beta / kappa
    h = TWO_PI / plate.steps[i]
    grid = Grid(plate.steps[i], h, math.cos(h), math.sin(h), plate.implicit)
    return SteppedSpring(
        gravity=1.0 / gamma,
        grid=grid,
        contact=law(grid, b, w, kappa, beta, lead, False),
        flight=law(grid, b, w, 0.0, 0.0, lead, True),
        sag=-1.0 / (gamma * w),
        dent=-2.0 / (gamma * kappa),
    )


@rest.register(SteppedSpring)
@jit
def _rest(s: SteppedSpring) -> tuple[float, float, float, float]:
    return s.dent, 0.0, s.sag, 0.0


@flies.register(SteppedSpring)
@jit
def _flies(s: SteppedSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    return lets_go(gap, gap1, 1.0, s.flight.lead)


@jit
def _locate(s: SteppedSpring, law: Law, x: Point, phi: float) -> tuple[float, Point]:
    """The length of the step from x at phi that ends where the contact or flight does, and its end."""
    m, f0 = s.grid.implicit, math.cos(phi) - s.gravity
    low, high, side = 0.0, s.grid.step, 0
    end = step(law, m, f0, math.cos(phi + high) - s.gravity, x, high)
    below, above = over(law, x), over(law, end)
    h = high
    if below >= 0.0 or above <= 0.0:
        return h, end
    for _ in range(ROUNDS):
        h = high - above * (high - low) / (above - below)
        end = step(law, m, f0, math.cos(phi + h) - s.gravity, x, h)
        found = over(law, end)
        if found == 0.0 or high - low <= 4.0 * EPS * s.grid.step:
            break
        if found > 0.0:
            below *= 0.5 if side > 0 else 1.0
            high, above, side = h, found, 1
        else:
            above *= 0.5 if side < 0 else 1.0
            low, below, side = h, found, -1
    return h, end


@jit
def _end(s: SteppedSpring, law: Law, row: March, n: int, phi: float) -> tuple[float, int, Point]:
    """The end of a contact or flight that began at phi and is over at the n-th grid point; as `_run`."""
    if row.taken == 0:
        return n * s.grid.step - phi, ROOT, row.now
    part, end = _locate(s, law, before(s.grid, row), (n - 1) % s.grid.steps * s.grid.step)
    if not abs(end.gap) + abs(end.q) + abs(part) < LARGEST:
        return n * s.grid.step - phi, NON_FINITE, end
    return (n - 1) * s.grid.step - phi + part, ROOT, end


@jit
def _run(
    s: SteppedSpring, law: Law, phi: float, x: Point, horizon: float, budget: int
) -> tuple[float, int, Point]:
    """Step until the contact or flight is over, or to the horizon: rad, ending and state."""
    steps, h, m = s.grid.steps, s.grid.step, s.grid.implicit
    if budget <= 0 or steps > MOST_STEPS_PER_PERIOD:
        return 0.0, BUDGET_EXHAUSTED, x
    last = math.floor((phi + horizon) / h + 0.5)
    n = math.floor(phi / h + SLIVER) + 1
    if n > last:
        return horizon, HORIZON, x
    f0, f1 = math.cos(phi) - s.gravity, math.cos(n % steps * h) - s.gravity
    row = outset(s.grid, law, f1, step(law, m, f0, f1, x, n * h - phi))
    while True:
        c, d = math.cos(n % steps * h), math.sin(n % steps * h)
        row = march(s.grid, law, s.gravity, c, d, row, min(BLOCK, last - n))
        n += row.taken
        if not abs(row.now.gap) + abs(row.now.q) < LARGEST:
            return n * h - phi, NON_FINITE, row.now
        if row.over:
            break
        if n == last:
            return horizon, HORIZON, row.now
    return _end(s, law, row, n, phi)


@contact.register(SteppedSpring)
@jit
def _contact(
    s: SteppedSpring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    """In contact until take-off. The budget counts phases; `kernel.step_limits` bounds the steps."""
    tau, ending, x = _run(s, s.contact, phi, Point(gap, gap1, q, q1), horizon, budget)
    gap, gap1 = x.gap, x.gap1
    if ending == ROOT and s.contact.lead == 0.0:
        gap, gap1 = max(gap, 0.0), max(gap1, 0.0)
    return Phase(tau, ending, ending == ROOT, gap, gap1, x.q, x.q1, 1)


@flight.register(SteppedSpring)
@jit
def _flight(
    s: SteppedSpring, phi: float, gap: float, gap1: float, q: float, q1: float, horizon: float, budget: int
) -> Phase:
    tau, ending, x = _run(s, s.flight, phi, Point(gap, gap1, q, q1), horizon, budget)
    gap, gap1 = x.gap, x.gap1
    if ending == ROOT:
        gap, gap1 = min(gap, 0.0), min(gap1, 0.0)
    return Phase(tau, ending, ending != ROOT, gap, gap1, x.q, x.q1, 1)
