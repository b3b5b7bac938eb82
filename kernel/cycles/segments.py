"""One round of a cycle of any contact, segment by segment: its equations and their exact derivatives.

A cycle is a cyclic list of segments, a letter each, which says how the segment moves and how it ends:

    S  the mass sticks to an ideal plate until n = 0
    h  a flight that lands on an ideal plate, and the mass leaves again: a hop
    c  a flight that lands, and the rest of the chatter, in closed form; then the mass sticks
    s  a flight that lands without restitution, and the mass sticks
    z  a flight that lands without restitution where n < 0: the mass takes off again at once
    C  a soft contact
    F  a flight that lands on a soft plate
    b  a flight that returns to contact below the surface of a soft plate, without adhesion

The unknowns are the state at the beginning, (gap', q, q', c, s) with gap = 0 and c + i s = Gamma e^{i phi},
and the duration of each segment. The equations are one fewer: an event ends each segment, gap', q and q'
return to their values, and the durations add up to 2 pi periods. With lengths in units of g/omega**2 every
motion is linear in the state, so that one function moves the state and all its derivatives. An event function
has a root at zero duration, which is divided out: so nothing is singular where a flight or contact vanishes.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.cycles.spring import SERIES_BELOW, TERMS
from kernel.interface import Phase, State, contact, flies, flight, plate_phase, prepare
from kernel.models.contact_law import chatter_lift, chatter_lift_variation, chatter_push, plate_force
from kernel.models.flight import remainders
from kernel.models.rigid import Spring
from kernel.models.soft_contact import SoftSpring, combine, forced, separate
from kernel.numerics.elementary import TWO_PI, sincos
from kernel.numerics.first_root import ROOT
from kernel.numerics.jit import allocating, by_type, inlined, jit
from kernel.numerics.oscillator import SHORT, propagator, response
from kernel.params import Cell

STUCK, HOP, CHATTER, STICKS, TAKES_OFF = (ord(letter) for letter in "Shcsz")
CONTACT, FLIGHT, BELOW = (ord(letter) for letter in "CFb")

#: Number of unknowns of the start; the durations follow.
START: Final = 5

#: Replaces a duration of exactly zero, which is a divisor.
_SHORTEST: Final = 1e-30

#: Elimination takes the next row if its pivot is at least this part of the other entries left in it.
_PIVOT: Final = 0.01

#: Parameters along which branches are followed.
ALONG: Final = ("gamma", "omega", "xi")
#: Relative step of the derivatives by Omega and xi.
_DIFFERENCE: Final = 1e-6
#: The least xi whose step is relative to it. xi itself may be 0, and both sides of it have cycles.
_UNDAMPED: Final = 1e-3
#: Newton steps below this, relative, that grow are of rounding: a long cycle near a graze is known no better.
_ROUNDING: Final = 1e-9
#: A Newton step above this, relative, in any unknown has left the branch.
_AWAY: Final = 2.0

#: Limit on the evaluations of one phase of the kernel.
_BUDGET: Final = 1_000_000


class Motion(NamedTuple):
    """A state and the constant 1, or a derivative of both. The equations of motion are linear in it."""

    gap: float
    gap1: float
    q: float
    q1: float
    cos: float  # Gamma cos(phi)
    sin: float
    unit: float


class Fall(NamedTuple):
    """Functions of the time t whose combinations are a flight; accurate as t -> 0."""

    c: float  # q(t) = q(0) c + q'(0) s
    s: float
    s1: float
    s_int: float  # integral of s from 0 to t
    s_int2: float  # and the integral of that
    s_rest: float  # s - t
    s_int_rest: float  # s_int - t**2/2
    sin_rest: float  # t - sin t
    cos_rest: float  # 1 - cos t - t**2/2
    versine: float  # 1 - cos t


@inlined
def _get(x: Any, j: int) -> Motion:
    """Row j of x (., 7)."""
    return Motion(x[j, 0], x[j, 1], x[j, 2], x[j, 3], x[j, 4], x[j, 5], x[j, 6])


@inlined
def _put(x: Any, j: int, z: Motion) -> None:
    """Overwrite row j of x (., 7)."""
    x[j, 0], x[j, 1], x[j, 2], x[j, 3], x[j, 4], x[j, 5], x[j, 6] = z


@inlined
def _turned(z: Motion, sin: float, cos: float) -> tuple[float, float]:
    """The components c and s after the plate has turned by an angle."""
    return z.cos * cos - z.sin * sin, z.cos * sin + z.sin * cos


# --- flights, the same for both plates ----------------------------------------------------------------------


@jit
def _fall(spring: Any, t: float) -> Fall:
    """The functions of a flight after t > 0 rad."""
    b, w = spring.flight.damping, 0.5 * spring.flight.stiffness
    c, s, s1 = response(spring.flight, t)
    sin, _ = sincos(t)
    half, _ = sincos(0.5 * t)
    versine = 2.0 * half * half
    s_int = (1.0 - c) / (2.0 * w)
    s_int2 = (t - s - 2.0 * b * s_int) / (2.0 * w)
    s_rest, s_int_rest = s - t, s_int - 0.5 * t * t
    if t * max(math.sqrt(2.0 * w), 2.0 * b) < SERIES_BELOW:
        before, last, power = 0.0, 1.0, t  # derivatives of s at zero, and t**n/n!
        s_rest, s_int_rest, double = 0.0, 0.0, 0.0
        for n in range(2, TERMS):
            before, last = last, -2.0 * b * last - 2.0 * w * before
            power *= t / n
            s_rest += last * power
            s_int_rest += last * power * t / (n + 1)
            double += last * power * t * t / ((n + 1) * (n + 2))
        s_int, s_int2 = 0.5 * t * t + s_int_rest, t * t * t / 6.0 + double
    sin_rest, cos_rest = t - sin, versine - 0.5 * t * t
    if t < SHORT:
        sin_rest, cos_rest = remainders(t)
        cos_rest = -cos_rest
    return Fall(c, s, s1, s_int, s_int2, s_rest, s_int_rest, sin_rest, cos_rest, versine)


@inlined
def _gap2(spring: Any, z: Motion) -> float:
    press: float = spring.flight.damping * z.q1 + 0.5 * spring.flight.stiffness * z.q
    return press + z.cos - z.unit


@jit
def _fly(spring: Any, t: float, power: int, x: Any) -> None:
    """Move the rows of x over a flight. power 3: gap'' = -n at its beginning is zero by an equation."""
    f = _fall(spring, t)
    b, w = spring.flight.damping, 0.5 * spring.flight.stiffness
    sin, cos = sincos(t)
    for j in range(len(x)):
        z = _get(x, j)
        press = b * z.q1 + w * z.q
        gap2 = 0.0 if power == 3 else _gap2(spring, z)
        gap = z.cos * f.cos_rest - z.sin * f.sin_rest + press * f.s_int_rest + w * z.q1 * f.s_int2
        gap1 = press * f.s_rest + w * z.q1 * f.s_int - z.cos * f.sin_rest - z.sin * f.versine
        c, s = _turned(z, sin, cos)
        end = Motion(
            z.gap + t * z.gap1 + 0.5 * t * t * gap2 + gap, z.gap1 + t * gap2 + gap1,
            z.q * f.c + z.q1 * f.s, z.q1 * f.s1 - spring.flight.stiffness * f.s * z.q, c, s, z.unit,
        )  # fmt: skip
        _put(x, j, end)


@inlined
def _falling(spring: Any, z: Motion) -> Motion:
    """The rate of change in flight."""
    osc = spring.flight
    q2 = -2.0 * osc.damping * z.q1 - osc.stiffness * z.q
    return Motion(z.gap1, _gap2(spring, z), z.q1, q2, -z.sin, z.cos, 0.0)


# --- what depends on the plate ------------------------------------------------------------------------------


@by_type
def root_power(spring: Any, letter: int, before: int) -> int:  # type: ignore[empty-body]
    """The power of the root at zero duration of a segment's event function."""


@by_type
def move(spring: Any, letter: int, before: int, t: float, x: Any) -> None:
    """Move the rows of x (., 7), motions, over t > 0 rad of a segment."""


@by_type
def rate(spring: Any, letter: int, z: Motion) -> Motion:  # type: ignore[empty-body]
    """The rate of change within a segment, per rad."""


@by_type
def event(spring: Any, letter: int, z: Motion) -> float:  # type: ignore[empty-body]
    """The event function: positive within the segment, falling through zero at its end."""


@by_type
def reset(spring: Any, letter: int, x: Any) -> float:  # type: ignore[empty-body]
    """Carry the rows of x (., 7), the value first, through the event; n of a mass that sticks to it."""


@by_type
def letter_of(spring: Any, flew: bool, end: Phase) -> int:  # type: ignore[empty-body]
    """The letter of a flight (`flew`) or contact of the kernel, by how it ended."""


@root_power.register(Spring)
@jit
def _rigid_power(spring: Spring, letter: int, before: int) -> int:
    """After sticking gap, gap' and n are zero; after an immediate take-off gap and gap'; after a hop gap."""
    if letter == STUCK:
        return 0
    return 3 if before == STUCK else 2 if before == TAKES_OFF else 1


@move.register(Spring)
@jit
def _rigid_move(spring: Spring, letter: int, before: int, t: float, x: Any) -> None:
    """Stuck, the elongation is a driven oscillator."""
    if letter != STUCK:
        _fly(spring, t, _rigid_power(spring, letter, before), x)
        return
    c, s, s1 = response(spring.stuck, t)
    sin, cos = sincos(t)
    static, re, im = spring.static_elongation, spring.q_re, spring.q_im
    for j in range(len(x)):
        z = _get(x, j)
        h = z.q - static * z.unit - (re * z.cos - im * z.sin)
        h1 = z.q1 + (re * z.sin + im * z.cos)
        cos_j, sin_j = _turned(z, sin, cos)
        q = h * c + h1 * s + static * z.unit + (re * cos_j - im * sin_j)
        q1 = h1 * s1 - spring.stuck.stiffness * s * h - (re * sin_j + im * cos_j)
        _put(x, j, Motion(0.0, 0.0, q, q1, cos_j, sin_j, z.unit))


@inlined
def _sticking(spring: Spring, z: Motion) -> Motion:
    """The rate of change of a mass that sticks."""
    q2 = z.cos - z.unit - spring.dashpot * z.q1 - spring.stiffness * z.q
    return Motion(0.0, 0.0, z.q1, q2, -z.sin, z.cos, 0.0)


@rate.register(Spring)
@jit
def _rigid_rate(spring: Spring, letter: int, z: Motion) -> Motion:
    return _sticking(spring, z) if letter == STUCK else _falling(spring, z)


@inlined
def _force(spring: Spring, z: Motion) -> float:
    """n of a mass that sticks."""
    return z.unit - z.cos - spring.dashpot * z.q1 - spring.stiffness * z.q


@event.register(Spring)
@jit
def _rigid_event(spring: Spring, letter: int, z: Motion) -> float:
    return _force(spring, z) if letter == STUCK else z.gap


@reset.register(Spring)
@jit
def _rigid_reset(spring: Spring, letter: int, x: Any) -> float:
    """A landing: the upper mass keeps its velocity, so that q' gains what gap' loses."""
    if letter == STUCK:
        return 0.0
    kept = spring.restitution if letter == HOP else 0.0
    z = _get(x, 0)
    value = Motion(0.0, 0.0, z.q, z.q1 + z.gap1, z.cos, z.sin, 1.0)
    force = _force(spring, value)
    if letter == CHATTER:
        _rest_of_chatter(spring, value, x)
        return force
    for j in range(len(x)):
        z = _get(x, j)
        _put(x, j, Motion(0.0, -kept * z.gap1, z.q, z.q1 + (1.0 + kept) * z.gap1, z.cos, z.sin, z.unit))
    return force


@jit
def _rest_of_chatter(spring: Spring, value: Motion, x: Any) -> None:
    """Carry the rows of x, at a landing, to the end of the chatter that begins there.

    value: the state if the mass stuck at once. The rest adds a function of the first hop, n and n', as in
    `kernel.models.rigid`.
    """
    b, w, e = spring.dashpot, spring.stiffness, spring.restitution
    hop = max(-e * x[0, 1], _SHORTEST)
    n = _force(spring, value)
    n1 = _force(spring, _sticking(spring, value)) + b * n
    lift = chatter_lift(hop, n, n1, e)
    for j in range(len(x)):
        z = _get(x, j)
        stuck = Motion(0.0, 0.0, z.q, z.q1 + z.gap1, z.cos, z.sin, z.unit)
        if j > 0:
            dn = _force(spring, stuck)
            dn1 = _force(spring, _sticking(spring, stuck)) + b * dn
            lift = chatter_lift_variation(hop, n, n1, e, -e * z.gap1, dn, dn1)
        more, more1 = chatter_push(b, w, *lift)
        _put(x, j, Motion(0.0, 0.0, stuck.q + more, stuck.q1 + more1, z.cos, z.sin, z.unit))


@letter_of.register(Spring)
@jit
def _rigid_letter(spring: Spring, flew: bool, end: Phase) -> int:
    if not flew:
        return STUCK
    if end.in_flight:
        return HOP if end.state.gap1 > 0.0 else TAKES_OFF
    return CHATTER if spring.restitution > 0.0 else STICKS


@root_power.register(SoftSpring)
@jit
def _soft_power(spring: SoftSpring, letter: int, before: int) -> int:
    """1 if a segment ends as it began; without adhesion a contact begins at gap = 0 and ends at n = 0."""
    return 1 if spring.adhesive or BELOW in (letter, before) else 0


@move.register(SoftSpring)
@jit
def _soft_move(spring: SoftSpring, letter: int, before: int, t: float, x: Any) -> None:
    """In contact the motion has a static, a driven and two free parts (`kernel.models.soft_contact`)."""
    if letter != CONTACT:
        _fly(spring, t, _soft_power(spring, letter, before), x)
        return
    gap_over, elongation_over = propagator(spring.gap_mode, t), propagator(spring.elongation_mode, t)
    sin, cos = sincos(t)
    for j in range(len(x)):
        z = _get(x, j)
        gap, gap1, q, q1 = forced(spring, z.cos, z.sin, z.unit)
        m = separate(spring, State(z.gap - gap, z.gap1 - gap1, z.q - q, z.q1 - q1))
        free = combine(spring, m, gap_over, elongation_over)
        c, s = _turned(z, sin, cos)
        gap, gap1, q, q1 = forced(spring, c, s, z.unit)
        _put(x, j, Motion(free.gap + gap, free.gap1 + gap1, free.q + q, free.q1 + q1, c, s, z.unit))


@rate.register(SoftSpring)
@jit
def _soft_rate(spring: SoftSpring, letter: int, z: Motion) -> Motion:
    """As in flight; in contact n also pushes the lower mass up, and so shortens the spring."""
    f = _falling(spring, z)
    n = plate_force(spring.kappa, spring.beta, z.gap, z.gap1) if letter == CONTACT else 0.0
    return Motion(f.gap, f.gap1 + n, f.q, f.q1 - n, f.cos, f.sin, 0.0)


@event.register(SoftSpring)
@jit
def _soft_event(spring: SoftSpring, letter: int, z: Motion) -> float:
    if letter == FLIGHT:
        return z.gap
    force = plate_force(spring.kappa, spring.beta, z.gap, z.gap1)
    if letter == BELOW:
        return -force
    return -z.gap if spring.adhesive else force


@reset.register(SoftSpring)
@jit
def _soft_reset(spring: SoftSpring, letter: int, x: Any) -> float:
    """Set the gap to zero, except at a take-off without adhesion and at a return below the surface."""
    if letter == FLIGHT or (letter == CONTACT and spring.adhesive):
        for j in range(len(x)):
            x[j, 0] = 0.0
    return 0.0


@letter_of.register(SoftSpring)
@jit
def _soft_letter(spring: SoftSpring, flew: bool, end: Phase) -> int:
    if not flew:
        return CONTACT
    return BELOW if end.state.gap < 0.0 else FLIGHT


# --- a whole cycle ------------------------------------------------------------------------------------------


class Round(NamedTuple):
    """One round of a cycle of n segments; m = START + n unknowns."""

    value: Any  # (m - 1,) values of the equations
    slope: Any  # (m - 1, m) their derivatives by the unknowns
    starts: Any  # (n + 1, 7) motions at each segment's beginning, and at the end
    rates: Any  # (n,) rates of the event functions at their ends; < 0
    forces: Any  # (n,) n of a mass that sticks, at each landing on an ideal plate


@allocating
def go_round(plate: Any, omega: float, xi: float, letters: Any, periods: int, u: Any) -> Round:
    """The equations of a cycle at unknowns u (m,), see the module. letters: (n,) uint8, plate: one cell."""
    spring = prepare(plate, 0, 1.0, omega, xi)  # Gamma = 1: lengths in g/omega**2
    n = len(letters)
    m = START + n
    x = np.zeros((1 + m, 7))
    x[0, 6] = 1.0
    for i in range(START):
        x[0, 1 + i], x[1 + i, 1 + i] = u[i], 1.0
    value, slope = np.empty(m - 1), np.empty((m - 1, m))
    starts, rates, forces = np.empty((n + 1, 7)), np.empty(n), np.empty(n)
    total = 0.0
    for i in range(n):
        letter, before, place = letters[i], letters[i - 1], START + i
        t = u[place] if u[place] != 0.0 else _SHORTEST
        total += u[place]
        _put(starts, i, _get(x, 0))
        power = root_power(spring, letter, before)
        gap2 = _gap2(spring, _get(x, 0)) if power == 3 else 0.0  # taken as zero by `move`
        move(spring, letter, before, t, x[: 1 + place])  # nothing depends on later durations yet
        now = rate(spring, letter, _get(x, 0))
        now = Motion(now.gap, now.gap1 - gap2, now.q, now.q1, now.cos, now.sin, 0.0)
        for j in range(6):
            x[1 + place, j] += now[j]
        scale = t ** (-power)
        value[i] = event(spring, letter, _get(x, 0)) * scale
        for j in range(m):
            slope[i, j] = event(spring, letter, _get(x, 1 + j)) * scale if j <= place else 0.0
        slope[i, place] -= power * value[i] / t
        rates[i] = event(spring, letter, now)
        forces[i] = reset(spring, letter, x[: 2 + place])
    _put(starts, n, _get(x, 0))
    for i in range(3):
        value[n + i] = x[0, 1 + i] - u[i]
        for j in range(m):
            slope[n + i, j] = x[1 + j, 1 + i]
        slope[n + i, i] -= 1.0
    value[m - 2] = total - TWO_PI * periods
    for j in range(m):
        slope[m - 2, j] = 0.0 if j < START else 1.0
    return Round(value, slope, starts, rates, forces)


@allocating
def equations(
    plate: Any, omega: float, xi: float, letters: Any, periods: int, along: int, gamma: float, x: Any
) -> Round:  # fmt: skip
    """The equations at unknowns x (m,) of a branch along one of `ALONG`, by its index.

    Along Gamma those of `go_round`. Else Omega or xi is the last unknown, which replaces the argument, and
    Gamma = `gamma` the last equation; derivatives by it are differences.
    """
    if along == 0:
        return go_round(plate, omega, xi, letters, periods, x)
    n = len(x) - 1
    u, value, slope = np.empty(n), np.empty(n), np.zeros((n, n + 1))
    for i in range(n):
        u[i] = x[i]
    step = _DIFFERENCE * max(x[n], _UNDAMPED if along == 2 else 0.0)
    for side in (-1.0, 1.0, 0.0):
        beside = x[n] + side * step
        cycle = go_round(
            plate, beside if along == 1 else omega, beside if along == 2 else xi, letters, periods, u
        )
        for i in range(n - 1):
            slope[i, n] += cycle.value[i] * (0.5 * side / step)
    for i in range(n - 1):
        value[i] = cycle.value[i]
        for j in range(n):
            slope[i, j] = cycle.slope[i, j]
    value[n - 1] = math.sqrt(u[3] * u[3] + u[4] * u[4]) - gamma
    slope[n - 1, 3], slope[n - 1, 4] = u[3] / gamma, u[4] / gamma
    return Round(value, slope, cycle.starts, cycle.rates, cycle.forces)


@allocating
def newton(
    plate: Any, omega: float, xi: float, letters: Any, periods: int, along: int, gamma: float, x: Any,
    direction: Any, goal: float, converged: float, most: int,
) -> tuple[bool, Any, Round, Any]:  # fmt: skip
    """Newton's method for `equations` from x (m,) on the plane direction . x = goal, at most `most` steps.

    converged: size of the last step, relative to x. Returns whether it converged, the unknowns, the equations
    there and the unit tangent (m,). Without steps it evaluates the equations.
    """
    m, before, done, found = len(x), math.inf, False, False
    x, tangent = x.copy(), direction.copy()
    for count in range(most + 1):
        cycle = equations(plate, omega, xi, letters, periods, along, gamma, x)
        if count == most or not _is_finite(cycle):
            break
        distance = -goal
        for i in range(m):
            distance += direction[i] * x[i]
        step, tangent = newton_step(len(letters), cycle.slope, cycle.value, direction, distance)
        size, scale, square = 0.0, 1.0, 0.0
        for i in range(m):
            size, scale = max(size, abs(step[i])), max(scale, abs(x[i]))
            square += tangent[i] * tangent[i]
        found = done
        if found:
            for i in range(m):
                tangent[i] /= math.sqrt(square)
        if found or not size < _AWAY * scale:
            break
        for i in range(m):
            x[i] -= step[i]
        done = size < converged * scale or before < size < _ROUNDING * scale
        before = size
    return found, x, cycle, tangent


@jit
def _is_finite(cycle: Round) -> bool:
    total = 0.0
    for i in range(len(cycle.value)):
        total += 0.0 * cycle.value[i]
        for j in range(cycle.slope.shape[1]):
            total += 0.0 * cycle.slope[i, j]
    return total == 0.0


@allocating
def monodromy(segments: int, slope: Any, u: Any) -> Any:
    """The derivative (4, 4) of the map of (gap', q, q', phase) over one round, at fixed parameters.

    slope: of `Round` at unknowns u. Events determine the durations, each from those up to its own.
    """
    times = np.empty((segments, 4))
    whole = np.eye(4)
    for i in range(segments + 3):
        for j in range(4):
            by_start = slope[i, j] if j < 3 else u[3] * slope[i, 4] - u[4] * slope[i, 3]
            for k in range(min(i, segments)):
                by_start += slope[i, START + k] * times[k, j]
            if i < segments:
                times[i, j] = -by_start / slope[i, START + i]
                whole[3, j] += times[i, j]
            else:
                whole[i - segments, j] += by_start
    return whole


@allocating
def newton_step(segments: int, slope: Any, value: Any, direction: Any, distance: float) -> tuple[Any, Any]:
    """Newton's step (m,) onto a plane, and the tangent (m,) of any length; NaN where there is none.

    slope (m - 1, m) and value (m - 1,) belong to the equations. The plane lies `distance` back along
    `direction` (m,). An event depends on the durations up to its own: with the durations first the matrix is
    nearly triangular, and elimination keeps it so by exchanging rows only where it must. A cycle of hundreds
    of hops takes START m**2 operations, not m**3.
    """
    n, m = segments, len(direction)
    # with slices and functions of arrays `newton` would compile nearly twice as long
    a = np.empty((m, m + 2))
    reach = np.empty(m, np.int64)  # in each row, entries of later durations are zero
    for i in range(m):
        row, largest = slope[i] if i < m - 1 else direction, 0.0
        for j in range(m):
            a[i, j] = row[_unknown(j, n)]
            largest = max(largest, abs(a[i, j]))
        a[i, m] = value[i] if i < m - 1 else distance
        a[i, m + 1] = 0.0 if i < m - 1 else 1.0
        reach[i] = i + 1 if i < n else n
        for j in range(m + 2):
            a[i, j] /= largest if largest > 0.0 else 1.0
    for k in range(m):
        p, others = k, 0.0
        for j in range(k + 1, m):
            others = max(others, abs(a[k, j]) if j < reach[k] or j >= n else 0.0)
        if k >= n or abs(a[k, k]) < _PIVOT * others:
            for i in range(k + 1, m):
                p = i if abs(a[i, k]) > abs(a[p, k]) else p
            for j in range(m + 2):
                a[k, j], a[p, j] = a[p, j], a[k, j]
            reach[k], reach[p] = reach[p], reach[k]
        for i in range(k + 1, m):
            if a[i, k] != 0.0:
                factor = a[i, k] / a[k, k]
                for j in range(k + 1, reach[k]):
                    a[i, j] -= factor * a[k, j]
                for j in range(max(n, k + 1), m + 2):
                    a[i, j] -= factor * a[k, j]
                reach[i] = max(reach[i], reach[k])
    solution = np.empty((2, m))
    for k in range(m - 1, -1, -1):
        for j in range(2):
            rest = a[k, m + j]
            for i in range(k + 1, m):
                rest -= a[k, i] * a[i, m + j]
            a[k, m + j] = rest / a[k, k]
            solution[j, _unknown(k, n)] = a[k, m + j]
    return solution[0], solution[1]


@inlined
def _unknown(k: int, segments: int) -> int:
    """Index of the k-th unknown if the durations come first."""
    if k < segments:
        return k + START
    return k - segments if k < segments + START else k


@allocating
def lowest(
    plate: Any, omega: float, xi: float, letter: int, before: int, start: Any, since: float, until: float,
    samples: int,
) -> tuple[float, float]:  # fmt: skip
    """Time, rad, and value of the first minimum of a segment's event function between two times; NaN if none.

    start (7,): motion at the segment's beginning. Minima closer together than the samples are missed.
    """
    spring = prepare(plate, 0, 1.0, omega, xi)
    x = np.empty((1, 7))
    low, low_slope = since, -1.0
    for i in range(samples + 1):
        high = since + (until - since) * i / samples
        _, slope, _ = _event_after(spring, letter, before, start, high, x)
        if i > 0 and low_slope < 0.0 <= slope:
            t = 0.5 * (low + high)
            for _ in range(100):
                _, slope, slope1 = _event_after(spring, letter, before, start, t, x)
                if slope < 0.0:
                    low = t
                else:
                    high = t
                step = t - slope / slope1 if slope1 > 0.0 else low
                step = step if low < step < high else 0.5 * (low + high)
                if abs(step - t) <= 1e-16 * (1.0 + t):
                    break
                t = step
            return t, _event_after(spring, letter, before, start, t, x)[0]
        low, low_slope = high, slope
    return math.nan, math.nan


@jit
def _event_after(
    spring: Any, letter: int, before: int, start: Any, t: float, x: Any
) -> tuple[float, float, float]:
    """A segment's event function after t rad, and its first two derivatives; x (1, 7) is overwritten."""
    for i in range(7):
        x[0, i] = start[i]
    gap2 = _gap2(spring, _get(x, 0)) if root_power(spring, letter, before) == 3 else 0.0
    move(spring, letter, before, t, x)
    z = _get(x, 0)
    now = rate(spring, letter, z)
    now = Motion(now.gap, now.gap1 - gap2, now.q, now.q1, now.cos, now.sin, 0.0)
    value, slope = event(spring, letter, z), event(spring, letter, now)
    return value, slope, event(spring, letter, rate(spring, letter, now))


def simulated(plate: Any, cell: Cell, state: Any, span: float, most: int) -> tuple[str, Any, Any]:
    """The kernel's segments from a state (6,), as STATE_FIELDS, over `span` rad, at most `most`.

    Returns letters (n,), durations (n,), rad, and states (n + 1, 4) at each beginning and at the end, without
    the segment that `span` cuts off.
    """
    gamma, omega, xi = map(float, cell)
    phi, _, *rest = map(float, state)
    letters, times, states = _simulated(plate, gamma, omega, xi, phi, State(*rest), span, most)
    return letters.tobytes().decode(), times, states


@allocating
def _simulated(
    plate: Any, gamma: float, omega: float, xi: float, phi: float, state: State, span: float, most: int
) -> tuple[Any, Any, Any]:
    spring = prepare(plate, 0, gamma, omega, xi)
    letters, times, states = np.empty(most, np.uint8), np.empty(most), np.empty((most + 1, 4))
    fly = flies(spring, plate_phase(phi), state)
    n = 0
    while n < most:
        states[n, 0], states[n, 1], states[n, 2], states[n, 3] = state
        here = plate_phase(phi)
        if fly:
            end = flight(spring, here, state, span, _BUDGET)
        else:
            end = contact(spring, here, state, span, _BUDGET)
        if end.ending != ROOT:
            break
        letters[n], times[n] = letter_of(spring, fly, end), end.tau
        n += 1
        phi += end.tau
        phi -= TWO_PI * math.floor(phi / TWO_PI)
        span -= end.tau
        fly, state = end.in_flight, end.state
    states[n, 0], states[n, 1], states[n, 2], states[n, 3] = state
    return letters[:n], times[:n], states[: n + 1]
