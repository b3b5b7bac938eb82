"""The soft plate by fixed time steps: the paper's molecular dynamics (section 2.2; docs/model.md, section 2).

The contact is that of `kernel.models.soft`, gap'' = b q' + w q - 1/Gamma + cos(phi) - kappa gap - beta gap'
while it lasts. The step is h = 2 pi/N rad, N being the fewest steps per plate period for which h is at most
the contact's duration over `steps_per_contact` (Eq. 13, `kernel.step_limits`). So the grid of phases at which
steps end is the same in every period.

The spring takes off or lands inside a step. With `located` events that step is shortened so that it ends
there (at the zero of the same scheme's own gap or force), and another shortened step leads back to the grid.
With `plain` events, as in textbooks, no step is shortened: the spring takes off or lands at the end of the
step, under the force of the gap there. So the force sets in late by up to h, and both schemes are of first
order. Events are detected at the ends of steps only: a touch or a hop shorter than a step may be missed, and
one that ends before the first grid point ends there.

One formula makes both schemes, m = 1/2 for velocity Verlet and m = 0 for semi-implicit Euler:
    v(1) = v + (1 - m) h a(x, v, phi)      x+ = x + h v(1)
    v+ = v(1) + m h a(x+, v+, phi + h)
With m = 1/2 the damping at the end of a step is that of the velocity there, which keeps Verlet of second
order and stable under any damping; the forces are linear, so that v+ costs a constant 2 x 2 matrix. Only
v(1) is carried from step to step: v(1)+ = P v(1) - S x+ + R f(phi + h), with f = cos(phi) - 1/Gamma. At the
end of a step v = v(1) + m (v(1)+ - v(1)). x is (gap, q), v their velocities per rad.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import Phase, PlatePhase, State, contact, contact_force, flies, flight, prepare, rest
from kernel.models.contact_law import contact_constants, lifted_off, plate_force, static_state
from kernel.numerics.elementary import TWO_PI, sincos
from kernel.numerics.first_root import BUDGET_EXHAUSTED, EPS, HORIZON, NON_FINITE, ROOT
from kernel.numerics.jit import inlined, jit
from kernel.params import check_arrays
from kernel.restitution import damping_ratio
from kernel.step_limits import MOST_STEPS_PER_PERIOD, Scheme, steps_per_period

BLOCK: Final = 1024  # steps between two evaluations of the plate's sine; rotations err by 2e-13
MIN_STEP_FRACTION: Final = 1e-9  # a grid point nearer than this part of a step, which is rounding, is skipped
LARGEST: Final = 1e30  # plate amplitudes; a gap or elongation beyond means that the scheme has diverged
ROUNDS: Final = 60  # cap on those of regula falsi (Illinois), which converges like a secant method


class SteppedPlate(NamedTuple):
    """The plate under each cell of a line."""

    damping: NDArray[np.float64]  # (n,) zeta
    penetration: NDArray[np.float64]  # (n,) d, plate amplitudes
    steps: NDArray[np.int64]  # (n,) to the plate period
    adhesive: bool
    implicit: float  # 1/2 for velocity Verlet, 0 for semi-implicit Euler
    plain: bool = False  # whether events wait for the end of their step


class Grid(NamedTuple):
    """The steps of a cell."""

    steps: int  # to the plate period
    step: float  # h = 2 pi/steps, rad
    cos: float  # of h
    sin: float
    implicit: float  # m


class Law(NamedTuple):
    """The forces of a contact or flight, and a step of the grid under them."""

    dashpot: float  # b = 2 xi/Omega
    stiffness: float  # w = 1/Omega**2
    kappa: float  # 1/d**2 in contact, 0 in flight
    beta: float  # 2 zeta/d in contact, 0 in flight
    lead: float  # contact while gap + lead * gap' < 0: 0 (adhesive) or beta/kappa
    flying: bool
    p: tuple[float, float, float, float]  # P by rows
    s: tuple[float, float, float, float]  # S by rows
    r: tuple[float, float]  # R


class March(NamedTuple):
    """A row of steps so far."""

    taken: int  # steps
    over: bool  # whether the contact or flight ended within the last of them
    now: State
    v: float  # gap' and q' as carried into the next step: v(1) of the last one
    u: float
    v0: float  # and of the one before
    u0: float


class SteppedSpring(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma
    grid: Grid
    contact: Law
    flight: Law
    static_elongation: float  # < 0
    static_gap: float  # < 0
    plain: bool


@jit
def _inverse(beta: float, b: float, mh: float) -> tuple[float, float, float, float]:
    """(1 + mh C)^-1 by rows, C = ((beta, -b), (-beta, 2b)) being the damping matrix for (gap', q')."""
    det = 1.0 + mh * (beta + 2.0 * b) + mh * mh * beta * b
    return (1.0 + 2.0 * mh * b) / det, mh * b / det, mh * beta / det, (1.0 + mh * beta) / det


@jit
def law(grid: Grid, b: float, w: float, kappa: float, beta: float, lead: float, flying: bool) -> Law:
    """The law of a contact, or with kappa = beta = 0 of a flight."""
    h = grid.step
    i, j, k, n = _inverse(beta, b, grid.implicit * h)
    g = (1.0 - grid.implicit) * h
    drag, drag1 = 1.0 - g * beta, 1.0 - 2.0 * g * b
    return Law(
        b, w, kappa, beta, lead, flying,
        p=(i * drag + j * g * beta, i * g * b + j * drag1, k * drag + n * g * beta, k * g * b + n * drag1),
        s=(h * kappa * (i - j), h * w * (2.0 * j - i), h * kappa * (k - n), h * w * (2.0 * n - k)),
        r=(h * i, h * k),
    )  # fmt: skip


@jit
def end_function(law: Law, x: State) -> float:
    """A function of the state that is negative within a contact or flight and zero at its end."""
    force = x.gap + law.lead * x.gap1
    return -max(x.gap, force) if law.flying else force


@jit
def _acceleration(law: Law, f: float, x: State) -> tuple[float, float]:
    """gap'' and q'', with f = cos(phi) - 1/Gamma."""
    spring = law.stiffness * x.q + law.dashpot * x.q1
    press = law.kappa * x.gap + law.beta * x.gap1
    return f + spring - press, press - 2.0 * spring


@jit
def step(law: Law, m: float, f0: float, f1: float, x: State, h: float) -> State:
    """One step from x of any length h (rad), with f = f0 before and f1 after it."""
    a, a1 = _acceleration(law, f0, x)
    v, u = x.gap1 + (1.0 - m) * h * a, x.q1 + (1.0 - m) * h * a1
    gap, q = x.gap + h * v, x.q + h * u
    a, a1 = _acceleration(law, f1, State(gap, 0.0, q, 0.0))
    v, u = v + m * h * a, u + m * h * a1
    i, j, k, n = _inverse(law.beta, law.dashpot, m * h)
    return State(gap, i * v + j * u, q, k * v + n * u)


@jit
def begin_march(grid: Grid, law: Law, f: float, x: State) -> March:
    """A row of no steps yet that begins at x, where f = cos(phi) - 1/Gamma."""
    a, a1 = _acceleration(law, f, x)
    v, u = x.gap1 - grid.implicit * grid.step * a, x.q1 - grid.implicit * grid.step * a1
    return March(0, False, x, v, u, v, u)


@jit
def march(grid: Grid, law: Law, gravity: float, c: float, d: float, start: March, steps: int) -> March:
    """`start` advanced by at most `steps` steps; c and d are cos and sin of the plate's phase."""
    (p0, p1, p2, p3), (s0, s1, s2, s3), (r0, r1) = law.p, law.s, law.r
    h, cos, sin, m, lead, flying = grid.step, grid.cos, grid.sin, grid.implicit, law.lead, law.flying
    gap, q = start.now.gap, start.now.q
    v, u, v0, u0 = start.v, start.u, start.v0, start.u0
    i = 0
    while True:
        f = c - gravity
        v1 = p0 * v + p1 * u - (s0 * gap + s1 * q) + r0 * f
        u1 = p2 * v + p3 * u - (s2 * gap + s3 * q) + r1 * f
        force = gap + lead * (v + m * (v1 - v))
        ended = gap < 0.0 and force < 0.0 if flying else force > 0.0
        if ended or i == steps:
            return March(i, ended, State(gap, v + m * (v1 - v), q, u + m * (u1 - u)), v, u, v0, u0)
        gap, q = gap + h * v1, q + h * u1
        v0, u0, v, u = v, u, v1, u1
        c, d = c * cos - d * sin, d * cos + c * sin
        i += 1


@jit
def previous_point(grid: Grid, m: March) -> State:
    """The end of the step before the last."""
    v, u = m.v0 + grid.implicit * (m.v - m.v0), m.u0 + grid.implicit * (m.u - m.u0)
    return State(m.now.gap - grid.step * m.v, v, m.now.q - grid.step * m.u, u)


def plate(
    *, restitution: NDArray[np.float64], penetration: NDArray[np.float64], adhesive: bool,
    steps_per_contact: int, scheme: Scheme, events: str = "located",
) -> SteppedPlate:  # fmt: skip
    """The plate under n cells; restitution (n,) in [0, 1], penetration (n,) > 0 in plate amplitudes.

    steps_per_contact: an integer >= 1; scheme: "verlet" or "euler"; events: "located" or "plain". Raises
    KernelInputError.
    """
    check_arrays({"restitution": restitution, "penetration": penetration})
    damping = damping_ratio(restitution, adhesive)
    steps = steps_per_period(restitution, penetration, steps_per_contact, adhesive=adhesive)
    return SteppedPlate(
        damping, np.ascontiguousarray(penetration), steps, bool(adhesive),
        0.5 if scheme == "verlet" else 0.0, events == "plain",
    )  # fmt: skip


@contact_force.register(SteppedSpring)
@jit
def _contact_force(s: SteppedSpring, phi: PlatePhase, state: State) -> float:
    return plate_force(s.contact.kappa, s.contact.beta, state.gap, state.gap1)


@prepare.register(SteppedPlate)
@jit
def _prepare(plate: SteppedPlate, i: int, gamma: float, omega: float, xi: float) -> SteppedSpring:
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
        plain=plate.plain,
    )


@rest.register(SteppedSpring)
@jit
def _rest(s: SteppedSpring) -> State:
    return State(s.static_gap, 0.0, s.static_elongation, 0.0)


@flies.register(SteppedSpring)
@jit
def _flies(s: SteppedSpring, phi: PlatePhase, state: State) -> bool:
    """Not in contact under the cell's law, with 1 : lead for kappa : beta."""
    return lifted_off(state.gap, state.gap1, 1.0, s.flight.lead)


@inlined
def _forcing(s: SteppedSpring, phi: float) -> float:
    """cos(phi) - 1/Gamma, the acceleration of a free mass relative to the plate."""
    _, cos = sincos(phi)
    return cos - s.gravity


@jit
def _locate(s: SteppedSpring, law: Law, x: State, phi: float) -> tuple[float, State]:
    """The length (rad) of the step from x at phi that ends where the contact or flight does, and its end."""
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
def _end(s: SteppedSpring, law: Law, row: March, n: int, phi: float) -> tuple[float, int, State]:
    """The end of a contact or flight that began at phi and is over at the n-th grid point, as `_run`."""
    if s.plain:
        d, c = sincos(n % s.grid.steps * s.grid.step)
        row = march(s.grid, s.contact if law.flying else s.flight, s.gravity, c, d, row, 0)
    if s.plain or row.taken == 0:
        return n * s.grid.step - phi, ROOT, row.now
    part, end = _locate(s, law, previous_point(s.grid, row), (n - 1) % s.grid.steps * s.grid.step)
    if not abs(end.gap) + abs(end.q) + abs(part) < LARGEST:
        return n * s.grid.step - phi, NON_FINITE, end
    return (n - 1) * s.grid.step - phi + part, ROOT, end


@jit
def _run(
    s: SteppedSpring, law: Law, phi: float, x: State, horizon: float, budget: int
) -> tuple[float, int, State]:
    """Step from x at phi until the end or the grid point nearest to the horizon: rad, ending and state."""
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
def _contact(s: SteppedSpring, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    """In contact until take-off. The budget counts contacts and flights; steps have a limit of their own."""
    tau, ending, x = _run(s, s.contact, phi.rad, state, horizon, budget)
    if ending == ROOT and s.contact.lead == 0.0 and not s.plain:
        x = State(max(x.gap, 0.0), max(x.gap1, 0.0), x.q, x.q1)
    return Phase(tau, ending, ending == ROOT, x, 1)


@flight.register(SteppedSpring)
@jit
def _flight(s: SteppedSpring, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    """In flight until contact returns; from below the surface perhaps rising: its velocity stays."""
    tau, ending, x = _run(s, s.flight, phi.rad, state, horizon, budget)
    if ending == ROOT and not s.plain:
        x = State(min(x.gap, 0.0), min(x.gap1, 0.0) if state.gap >= 0.0 else x.gap1, x.q, x.q1)
    return Phase(tau, ending, ending != ROOT, x, 1)
