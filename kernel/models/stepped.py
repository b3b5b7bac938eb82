"""The soft plate by fixed time steps: the paper's molecular dynamics (section 2.2; docs/model.md, section 2).

The contact is that of `kernel.models.soft`, gap'' = b q' + w q - 1/Gamma + cos(phi) - kappa gap - beta gap'
while it lasts, integrated by one of the schemes of `kernel.models.time_stepping`. The step is h = 2 pi/N
rad, N being the fewest steps per plate period for which h is at most the contact's duration over
`steps_per_contact` (Eq. 13, `kernel.step_limits`). So the grid of phases at which steps end is the same in
every period.

The spring takes off or lands inside a step. That step is shortened so that it ends there (at the zero of
the same scheme's own gap or force), and another shortened one leads back to the grid. Otherwise the force
would set in late by up to h, and both schemes would be of first order. Events are detected at the ends of
steps only: a touch or a hop shorter than a step may be missed, and one that ends before the first grid
point ends there.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import contact, contact_force, flies, flight, prepare, rest
from kernel.models.contact_law import contact_constants, lifted_off, plate_force, static_state
from kernel.models.time_stepping import (
    Grid,
    Law,
    March,
    Point,
    begin_march,
    end_function,
    law,
    march,
    previous_point,
    step,
)
from kernel.numerics.elementary import TWO_PI, sincos
from kernel.numerics.first_root import BUDGET_EXHAUSTED, EPS, HORIZON, NON_FINITE, ROOT, Phase
from kernel.numerics.jit import inlined, jit
from kernel.params import KernelInputError
from kernel.restitution import damping_ratio
from kernel.step_limits import MOST_STEPS_PER_PERIOD, Scheme, steps_per_period
from kernel.validation import check_arrays

#: Steps between two evaluations of the plate's sine and cosine; in between a rotation advances them, whose
#: error grows to some 1024 EPS = 2e-13.
BLOCK: Final = 1024

#: If less than this part of a step is left to the next grid point, that point is skipped: rounding moves
#: grid points by about N EPS/2 of a step, 1e-9 for the largest N.
MIN_STEP_FRACTION: Final = 1e-9

#: A gap or elongation beyond this, in plate amplitudes, means that the scheme is unstable and has diverged.
LARGEST: Final = 1e30

#: Cap on the rounds of regula falsi (Illinois) for the end of a contact or flight. It converges like a
#: secant method; halving alone would be down to rounding by then.
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
    static_elongation: float  # < 0
    static_gap: float  # < 0


def plate(
    *,
    restitution: NDArray[np.float64],
    penetration: NDArray[np.float64],
    adhesive: bool,
    steps_per_contact: int,
    scheme: str,
) -> SteppedPlate:
    """The plate under n cells; restitution (n,) in [0, 1], penetration (n,) > 0 in plate amplitudes.

    steps_per_contact: an integer >= 1; scheme: "verlet" or "euler". Raises KernelInputError.
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
    """n in contact."""
    return plate_force(s.contact.kappa, s.contact.beta, gap, gap1)


@prepare.register(SteppedPlate)
@jit
def _prepare(plate: SteppedPlate, i: int, gamma: float, omega: float, xi: float) -> SteppedSpring:
    """The constants of cell i."""
    kappa, beta = contact_constants(plate.penetration[i], plate.damping[i])
    w, b = 1.0 / (omega * omega), 2.0 * xi / omega
    static_gap, static_elongation = static_state(gamma, w, kappa)
    lead = 0.0 if plate.adhesive else beta / kappa
    h = TWO_PI / plate.steps[i]
    sin, cos = sincos(h)
    grid = Grid(plate.steps[i], h, cos, sin, plate.implicit)
    return SteppedSpring(
        gravity=1.0 / gamma,
        grid=grid,
        contact=law(grid, b, w, kappa, beta, lead, False),
        flight=law(grid, b, w, 0.0, 0.0, lead, True),
        static_elongation=static_elongation,
        static_gap=static_gap,
    )


@rest.register(SteppedSpring)
@jit
def _rest(s: SteppedSpring) -> tuple[float, float, float, float]:
    """At the static gap and elongation."""
    return s.static_gap, 0.0, s.static_elongation, 0.0


@flies.register(SteppedSpring)
@jit
def _flies(s: SteppedSpring, phi: float, gap: float, gap1: float, q: float, q1: float) -> bool:
    """Not in contact under the cell's law, with 1 : lead for kappa : beta."""
    return lifted_off(gap, gap1, 1.0, s.flight.lead)


@inlined
def _forcing(s: SteppedSpring, phi: float) -> float:
    """cos(phi) - 1/Gamma, the acceleration of a free mass relative to the plate."""
    _, cos = sincos(phi)
    return cos - s.gravity


@jit
def _locate(s: SteppedSpring, law: Law, x: Point, phi: float) -> tuple[float, Point]:
    """The length (rad) of the step from x at phi that ends where the contact or flight does, and its end.

    By regula falsi on `end_function`, as a function of the step's length.
    """
    m, f0 = s.grid.implicit, _forcing(s, phi)
    low, high, side = 0.0, s.grid.step, 0
    end = step(law, m, f0, _forcing(s, phi + high), x, high)
    below, above = end_function(law, x), end_function(law, end)
    h = high
    if below >= 0.0 or above <= 0.0:
        return h, end
    for _ in range(ROUNDS):
        h = high - above * (high - low) / (above - below)
        end = step(law, m, f0, _forcing(s, phi + h), x, h)
        value = end_function(law, end)
        if value == 0.0 or high - low <= 4.0 * EPS * s.grid.step:
            break
        if value > 0.0:
            below *= 0.5 if side > 0 else 1.0
            high, above, side = h, value, 1
        else:
            above *= 0.5 if side < 0 else 1.0
            low, below, side = h, value, -1
    return h, end


@jit
def _end(s: SteppedSpring, law: Law, row: March, n: int, phi: float) -> tuple[float, int, Point]:
    """The end of a contact or flight that began at phi and is over at the n-th grid point.

    Returns rad, ending and state, as `_run` does.
    """
    if row.taken == 0:
        return n * s.grid.step - phi, ROOT, row.now
    part, end = _locate(s, law, previous_point(s.grid, row), (n - 1) % s.grid.steps * s.grid.step)
    if not abs(end.gap) + abs(end.q) + abs(part) < LARGEST:
        return n * s.grid.step - phi, NON_FINITE, end
    return (n - 1) * s.grid.step - phi + part, ROOT, end


@jit
def _run(
    s: SteppedSpring, law: Law, phi: float, x: Point, horizon: float, budget: int
) -> tuple[float, int, Point]:
    """Step from x at phi until the contact or flight is over, or to the horizon: rad, ending and state.

    The horizon is rounded to the nearest grid point.
    """
    steps, h, m = s.grid.steps, s.grid.step, s.grid.implicit
    if budget <= 0 or steps > MOST_STEPS_PER_PERIOD:
        return 0.0, BUDGET_EXHAUSTED, x
    last = math.floor((phi + horizon) / h + 0.5)
    n = math.floor(phi / h + MIN_STEP_FRACTION) + 1
    if n > last:
        return horizon, HORIZON, x
    f0, f1 = _forcing(s, phi), _forcing(s, n % steps * h)
    row = begin_march(s.grid, law, f1, step(law, m, f0, f1, x, n * h - phi))
    while True:
        d, c = sincos(n % steps * h)
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
    """In contact until take-off. The budget counts contacts and flights; steps have a limit of their own."""
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
    """In flight until contact returns. The budget counts as in `_contact`.

    A flight that begins below the surface may end there, rising: its velocity then stays.
    """
    tau, ending, x = _run(s, s.flight, phi, Point(gap, gap1, q, q1), horizon, budget)
    after, after1 = x.gap, x.gap1
    if ending == ROOT:
        after = min(after, 0.0)
        after1 = min(after1, 0.0) if gap >= 0.0 else after1
    return Phase(tau, ending, ending != ROOT, after, after1, x.q, x.q1, 1)
