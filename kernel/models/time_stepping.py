"""Fixed time steps of the spring on the soft plate, in contact or in flight.

One formula makes both schemes, m = 1/2 for velocity Verlet and m = 0 for semi-implicit Euler:
    v(1) = v + (1 - m) h a(x, v, phi)      x+ = x + h v(1)
    v+ = v(1) + m h a(x+, v+, phi + h)
With m = 1/2 the damping at the end of a step is that of the velocity there, which keeps Verlet of second
order and stable under any damping; the forces are linear, so that v+ costs a constant 2 x 2 matrix. Only
v(1) is carried from step to step: v(1)+ = P v(1) - S x+ + R f(phi + h), with f = cos(phi) - 1/Gamma. At the
end of a step v = v(1) + m (v(1)+ - v(1)).

x is (gap, q) in plate amplitudes, v their velocities per rad, h in rad.
"""

from typing import NamedTuple

from kernel.numerics.jit import jit


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


class Point(NamedTuple):
    """The state at the end of a step."""

    gap: float
    gap1: float
    q: float
    q1: float


class March(NamedTuple):
    """A row of steps so far."""

    taken: int  # steps
    over: bool  # whether the contact or flight ended within the last of them
    now: Point
    v: float  # gap' and q' as carried into the next step: v(1) of the last one
    u: float
    v0: float  # and of the one before
    u0: float


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
def end_function(law: Law, x: Point) -> float:
    """A function of the state that is negative within a contact or flight and zero at its end."""
    force = x.gap + law.lead * x.gap1
    return -max(x.gap, force) if law.flying else force


@jit
def _acceleration(law: Law, f: float, x: Point) -> tuple[float, float]:
    """gap'' and q'', with f = cos(phi) - 1/Gamma."""
    spring = law.stiffness * x.q + law.dashpot * x.q1
    press = law.kappa * x.gap + law.beta * x.gap1
    return f + spring - press, press - 2.0 * spring


@jit
def step(law: Law, m: float, f0: float, f1: float, x: Point, h: float) -> Point:
    """One step from x of any length h (rad), with f = f0 before and f1 after it."""
    a, a1 = _acceleration(law, f0, x)
    v, u = x.gap1 + (1.0 - m) * h * a, x.q1 + (1.0 - m) * h * a1
    gap, q = x.gap + h * v, x.q + h * u
    a, a1 = _acceleration(law, f1, Point(gap, 0.0, q, 0.0))
    v, u = v + m * h * a, u + m * h * a1
    i, j, k, n = _inverse(law.beta, law.dashpot, m * h)
    return Point(gap, i * v + j * u, q, k * v + n * u)


@jit
def begin_march(grid: Grid, law: Law, f: float, x: Point) -> March:
    """A row of no steps yet that begins at x, where f = cos(phi) - 1/Gamma."""
    a, a1 = _acceleration(law, f, x)
    v, u = x.gap1 - grid.implicit * grid.step * a, x.q1 - grid.implicit * grid.step * a1
    return March(0, False, x, v, u, v, u)


@jit
def march(grid: Grid, law: Law, gravity: float, c: float, d: float, start: March, steps: int) -> March:
    """`start` advanced by `steps` steps, or fewer if the contact or flight ends.

    c and d are cosine and sine of the plate's phase at the start; a rotation advances them.
    """
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
            return March(i, ended, Point(gap, v + m * (v1 - v), q, u + m * (u1 - u)), v, u, v0, u0)
        gap, q = gap + h * v1, q + h * u1
        v0, u0, v, u = v, u, v1, u1
        c, d = c * cos - d * sin, d * cos + c * sin
        i += 1


@jit
def previous_point(grid: Grid, m: March) -> Point:
    """The end of the step before the last."""
    v, u = m.v0 + grid.implicit * (m.v - m.v0), m.u0 + grid.implicit * (m.u - m.u0)
    return Point(m.now.gap - grid.step * m.v, v, m.now.q - grid.step * m.u, u)
