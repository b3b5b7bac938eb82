"""Slow, obvious twins of the kernel, written from the equations of motion alone.

A spring of two masses over the plate cos(phi), in plate amplitudes and radians of phase, with
g the gap under the lower mass, q the elongation, w = 1/Omega**2 and b = 2 xi/Omega:

    q'' = -2 b q' - 2 w q - n          g'' = b q' + w q - 1/Gamma + cos(phi) + n

n is 0 in flight; on the ideal plate it is what keeps g'' = 0; on the soft one -(kappa g + beta g').
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpc, mpf
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

mp.dps = 80

#: A hop slower than this sticks, and a flight shorter than this is none.
SLOWEST_HOP = 1e-9
SHORTEST_FLIGHT = 1e-9

State = tuple[float, float, float, float]  # g, g', q, q'


class Setting(NamedTuple):
    """A cell and its contact; `soft` chooses between the two plates."""

    gamma: float
    omega: float
    xi: float
    soft: bool = False
    restitution: float = 0.0
    penetration: float = 1e-3
    adhesive: bool = True

    @property
    def w(self) -> float:
        return 1.0 / self.omega**2

    @property
    def b(self) -> float:
        return 2.0 * self.xi / self.omega

    @property
    def kappa(self) -> float:
        return 1.0 / self.penetration**2

    @property
    def beta(self) -> float:
        return 2.0 * damping_for(self.restitution, self.adhesive) / self.penetration if self.soft else 0.0

    def at_rest(self) -> State:
        return (
            (-2.0 / (self.gamma * self.kappa) if self.soft else 0.0),
            0.0,
            -1.0 / (self.gamma * self.w),
            0.0,
        )

    def stuck_force(self, phi: float, q: float, q1: float) -> float:
        return 1.0 / self.gamma - math.cos(phi) - self.b * q1 - self.w * q

    def push(self, gap: float, gap1: float) -> float:
        return -(self.kappa * gap + self.beta * gap1)


# --- an isolated impact ---------------------------------------------------------------------


def bounce(zeta: float, adhesive: bool) -> float:
    """Restitution of g'' + 2 zeta g' + g = 0 from g = 0, g' = -1, integrated."""

    def leaves(_: float, y: Sequence[float]) -> float:
        return y[0] if adhesive else y[0] + 2.0 * zeta * y[1]

    leaves.terminal, leaves.direction = True, 1  # type: ignore[attr-defined]
    path = solve_ivp(
        lambda _, y: (y[1], -y[0] - 2.0 * zeta * y[1]), (0.0, 200.0 * (1.0 + zeta)), (0.0, -1.0),
        "DOP853", events=leaves, rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    return float(path.y_events[0][0][1]) if len(path.y_events[0]) else 0.0


def restitution_of(zeta: float, adhesive: bool) -> float:
    """MODEL section 2, as printed there."""
    if adhesive:
        return math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0
    if zeta == 1.0:
        return math.exp(-2.0)
    s = math.sqrt(abs(zeta**2 - 1.0))
    if zeta < 1.0:
        return math.exp(-zeta / s * math.atan2(2.0 * zeta * s, 2.0 * zeta**2 - 1.0))
    # (zeta + s)/(zeta - s) without its cancellation
    return float((zeta + s) ** 2) ** (-zeta / s)


def damping_for(e: float, adhesive: bool) -> float:
    """The damping ratio that gives restitution e."""
    if e == 1.0:
        return 0.0
    if adhesive:
        return 1.0 if e == 0.0 else -math.log(e) / math.sqrt(math.pi**2 + math.log(e) ** 2)
    return float(brentq(lambda z: restitution_of(z, False) - e, 0.0, 1.0 / math.sqrt(e) + 2.0, xtol=1e-15))


# --- whole trajectories, integrated ---------------------------------------------------------


class Flown(NamedTuple):
    takeoff: float  # phase since the start, rad
    time: float


def trajectory(s: Setting, periods: float) -> list[Flown]:
    """Every flight from rest that takes off and lands within some plate periods, by DOP853."""
    phi, end = 0.0, 2.0 * math.pi * periods
    state, flying = s.at_rest(), not s.soft and s.gamma > 2.0
    took_off = False  # a flight that the spring begins in has not taken off
    flown = []
    while True:
        phi_before, was_flying = phi, flying
        phi, state, ended = _integrate(s, phi, state, flying, end)
        if not ended:
            return flown
        if was_flying and took_off and phi - phi_before > SHORTEST_FLIGHT:
            flown.append(Flown(phi_before, phi - phi_before))
        state, flying = _after(s, phi, state, was_flying)
        took_off = True


def _after(s: Setting, phi: float, state: State, was_flying: bool) -> tuple[State, bool]:
    """What a take-off or a landing does to a state, and whether a flight follows."""
    gap, gap1, q, q1 = state
    if s.soft:
        return (0.0 if s.adhesive else gap, gap1, q, q1), not was_flying
    if not was_flying:
        return (0.0, 0.0, q, q1), True
    hop = -s.restitution * gap1
    hop = 0.0 if hop < SLOWEST_HOP else hop
    q1 += gap1 - hop
    return (0.0, hop, q, q1), hop > 0.0 or s.stuck_force(phi, q, q1) < 0.0


def _integrate(s: Setting, phi: float, state: State, flying: bool, end: float) -> tuple[float, State, bool]:
    """One phase to its end: (phase, state, whether it ended before `end`)."""

    def force(phi: float, y: Sequence[float]) -> float:
        if flying:
            return 0.0
        return s.push(y[0], y[1]) if s.soft else s.stuck_force(phi, y[2], y[3])

    def slopes(phi: float, y: Sequence[float]) -> tuple[float, float, float, float]:
        n, spring = force(phi, y), s.b * y[3] + s.w * y[2]
        return y[1], spring - 1.0 / s.gamma + math.cos(phi) + n, y[3], -2.0 * spring - n

    def lasts(phi: float, y: Sequence[float]) -> float:
        """Positive as long as the phase lasts."""
        if flying:
            return max(y[0], -s.push(y[0], y[1])) if s.soft and not s.adhesive else y[0]
        if s.soft and s.adhesive:
            return -y[0]
        return force(phi, y)

    lasts.terminal, lasts.direction = True, -1  # type: ignore[attr-defined]
    widest = min(0.05, 0.1 * s.omega, 0.3 * s.penetration if s.soft and not flying else 1.0)
    path = solve_ivp(
        slopes, (phi, end), state, "DOP853", events=lasts, rtol=1e-12, atol=1e-18, max_step=widest
    )
    ended = len(path.t_events[0]) > 0
    last = path.y_events[0][0] if ended else path.y[:, -1]
    return float(path.t_events[0][0]) if ended else end, tuple(map(float, last)), ended  # type: ignore[return-value]


# --- one phase, exactly ---------------------------------------------------------------------


class Sum:
    """A sum of weight * exp(rate * tau), kept to 80 digits, so that nothing cancels visibly."""

    def __init__(self, weights: Sequence[mpc], rates: Sequence[mpc]) -> None:
        self.weights, self.rates = list(weights), list(rates)

    def __add__(self, other: "Sum") -> "Sum":
        return Sum(self.weights + other.weights, self.rates + other.rates)

    def times(self, factor: mpf) -> "Sum":
        return Sum([factor * weight for weight in self.weights], self.rates)

    def slope(self) -> "Sum":
        return Sum([w * r for w, r in zip(self.weights, self.rates, strict=True)], self.rates)

    def __call__(self, tau: float) -> mpf:
        pairs = zip(self.weights, self.rates, strict=True)
        return sum((weight * mp.exp(rate * tau) for weight, rate in pairs), mpc(0)).real

    def integral(self, other: "Sum", tau: float) -> mpf:
        """Of the product of two sums, from 0 to tau."""
        total = mpc(0)
        for w1, r1 in zip(self.weights, self.rates, strict=True):
            for w2, r2 in zip(other.weights, other.rates, strict=True):
                rate = r1 + r2
                total += w1 * w2 * (tau if rate == 0 else mp.expm1(rate * tau) / rate)
        return total.real

    def delicate(self, tau: float) -> bool:
        """Whether double precision would lose more than two digits to cancellation over tau rad."""
        weights, values = self._in_double(tau * np.logspace(-6, 0, 40))
        return bool(np.abs(weights).sum() > 100.0 * np.abs(values).max())

    def many(self, taus: np.ndarray) -> np.ndarray:
        """At many instants, in double precision where that does."""
        if self.delicate(float(taus[-1])):
            return np.array([float(self(tau)) for tau in taus])
        return self._in_double(taus)[1]

    def _in_double(self, taus: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        weights = np.array([complex(weight) for weight in self.weights])
        rates = np.array([complex(rate) for rate in self.rates])
        with np.errstate(under="ignore"):
            return weights, np.real(np.exp(np.outer(taus, rates)) @ weights)


class Exact(NamedTuple):
    """The motion of one phase, as functions of tau since it began."""

    gap: Sum
    gap1: Sum
    q: Sum
    q1: Sum
    force: Sum
    fall: tuple[mpf, mpf, mpf]  # what the gap has besides: c0 + c1 tau + c2 tau**2

    def state(self, tau: float) -> tuple[mpf, mpf, mpf, mpf]:
        c0, c1, c2 = self.fall
        gap, gap1 = self.gap(tau) + c0 + c1 * tau + c2 * mpf(tau) ** 2, self.gap1(tau) + c1 + 2 * c2 * tau
        return gap, gap1, self.q(tau), self.q1(tau)

    def gaps(self, taus: np.ndarray) -> np.ndarray:
        c0, c1, c2 = (float(c) for c in self.fall)
        return np.asarray(self.gap.many(taus) + c0 + c1 * taus + c2 * taus**2)

    def fastest(self) -> float:
        return max(float(abs(rate)) for rate in self.q.rates + self.gap.rates)


class _Constants(NamedTuple):
    """A setting to 80 digits, 1e-25 beside anything that is exactly critical or resonant."""

    gravity: mpf
    w: mpf
    b: mpf
    kappa: mpf
    beta: mpf


def _constants(s: Setting) -> _Constants:
    omega, xi = mpf(s.omega) * (1 + mpf("3e-25")), mpf(s.xi) * (1 + mpf("1e-25"))
    beta = mpf(s.beta) * (1 - mpf("2e-25"))
    return _Constants(1 / mpf(s.gamma), omega**-2, 2 * xi / omega, mpf(s.penetration) ** -2, beta)


def _free(polynomial: Sequence[mpf], values: Sequence[mpf]) -> Sum:
    """The motion with this characteristic polynomial (highest first) and these first derivatives."""
    rates = _roots(tuple(polynomial))
    powers = mp.matrix([[rate**order for rate in rates] for order in range(len(rates))])
    return Sum(list(mp.lu_solve(powers, mp.matrix(list(values)))), rates)


_known: dict[tuple[mpf, ...], list[mpc]] = {}


def _roots(polynomial: tuple[mpf, ...]) -> list[mpc]:
    if polynomial not in _known:
        if len(polynomial) == 3:
            _, half, product = polynomial[0], -polynomial[1] / 2, polynomial[2]
            root = mp.sqrt(mpc(half * half - product))
            _known[polynomial] = [half + root, half - root]
        else:
            _known[polynomial] = [mpc(r) for r in mp.polyroots(polynomial, maxsteps=2000, extraprec=400)]
    return _known[polynomial]


def _wave(amplitude: mpc, phi: float) -> Sum:
    """Re(amplitude exp(i (phi + tau)))."""
    turned = amplitude * mp.expj(mpf(phi)) / 2
    return Sum([turned, mp.conj(turned)], [mpc(0, 1), mpc(0, -1)])


def _still(value: mpf) -> Sum:
    return Sum([mpc(value)], [mpc(0)])


def flight(s: Setting, phi: float, state: State) -> Exact:
    c = _constants(s)
    gap, gap1, q, q1 = map(mpf, state)
    q_sum = _free((mpf(1), 2 * c.b, 2 * c.w), (q, q1))
    plate = _wave(mpc(-1), phi)
    fall = (gap + mp.cos(mpf(phi)) + q / 2, gap1 - mp.sin(mpf(phi)) + q1 / 2, -c.gravity / 2)
    gap_sum = plate + q_sum.times(mpf("-0.5"))
    return Exact(gap_sum, gap_sum.slope(), q_sum, q_sum.slope(), _still(mpf(0)), fall)


def stuck(s: Setting, phi: float, state: State) -> Exact:
    """On the ideal plate: q'' + b q' + w q = cos(phi) - 1/Gamma."""
    c = _constants(s)
    driven = _wave(1 / mpc(c.w - 1, c.b), phi) + _still(-c.gravity / c.w)
    free = (mpf(state[2]) - driven(0), mpf(state[3]) - driven.slope()(0))
    q = _free((mpf(1), c.b, c.w), free) + driven
    force = _still(c.gravity) + _wave(mpc(-1), phi) + q.slope().times(-c.b) + q.times(-c.w)
    nothing, none = _still(mpf(0)), (mpf(0), mpf(0), mpf(0))
    return Exact(nothing, nothing, q, q.slope(), force, none)


def pressed(s: Setting, phi: float, state: State) -> Exact:
    """On the soft plate: u' = M u + drive for u = (g, g', q, q')."""
    c = _constants(s)
    matrix = mp.matrix([
        [0, 1, 0, 0],
        [-c.kappa, -c.beta, c.w, c.b],
        [0, 0, 0, 1],
        [c.kappa, c.beta, -2 * c.w, -2 * c.b],
    ])  # fmt: skip
    still = mp.lu_solve(matrix, mp.matrix([0, c.gravity, 0, 0]))
    waves = mp.lu_solve(mp.eye(4) * mpc(0, 1) - matrix, mp.matrix([0, 1, 0, 0]))
    turn = mp.expj(mpf(phi))
    derivatives = [mp.matrix([mpf(x) for x in state]) - still - (waves * turn).apply(mp.re)]
    for _ in range(3):
        derivatives.append(matrix * derivatives[-1])
    polynomial = (mpf(1), c.beta + 2 * c.b, c.kappa + 2 * c.w + c.b * c.beta,
                  c.b * c.kappa + c.w * c.beta, c.w * c.kappa)  # fmt: skip
    gap, gap1, q, q1 = (
        _free(polynomial, [d[i] for d in derivatives]) + _wave(waves[i], phi) + _still(still[i])
        for i in range(4)
    )
    return Exact(gap, gap1, q, q1, gap.times(-c.kappa) + gap1.times(-c.beta), (mpf(0), mpf(0), mpf(0)))


def exact(s: Setting, flying: bool, phi: float, state: State) -> Exact:
    """The phase that begins in this state."""
    return (flight if flying else pressed if s.soft else stuck)(s, phi, state)


def energy(s: Setting, phi: float, state: Sequence[float]) -> tuple[float, float]:
    """Kinetic, potential and elastic energy in the laboratory, and the size of what was added up."""
    gap, gap1, q, q1 = state
    lower = gap1 - math.sin(phi)
    parts = (lower**2 / 2, (lower + q1) ** 2 / 2, (2 * (gap + math.cos(phi)) + q) / s.gamma, q * q * s.w / 2)
    return float(math.fsum(parts)), float(sum(abs(part) for part in parts))


def work(s: Setting, motion: Exact, phi: float, tau: float) -> tuple[float, float]:
    """What the dashpot takes and the plate gives over tau rad, and the size of what was added up."""
    lost = float(s.b * motion.q1.integral(motion.q1, tau))
    lower = motion.gap1 + _wave(mpc(0, 1), phi)  # alpha_2' = g' - sin(phi)
    given = float(motion.force.integral(lower, tau))
    return given - lost, lost + abs(given)


# --- first roots by looking everywhere ------------------------------------------------------


def instants(motion: Exact, tau: float, most: int) -> np.ndarray:
    """Where to look: a hundred times in every turn of the fastest ringing, or `most` times in all."""
    if motion.gap.delicate(tau) or motion.force.delicate(tau):
        most = min(most, 300)
    turns = tau * motion.fastest() / (2.0 * math.pi)
    even = np.linspace(0.0, tau, min(most, 200 + int(100.0 * turns)))
    return np.unique(np.concatenate([even, tau * np.logspace(-12, 0, min(most // 3, 300))]))


def lowest(function: Callable[[np.ndarray], np.ndarray], taus: np.ndarray) -> tuple[float, float]:
    """The least value and where, looking closer around each of the least samples."""
    values = function(taus)
    inner = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1
    best = int(np.argmin(values))
    least, where = float(values[best]), float(taus[best])
    for i in inner[np.argsort(values[inner])][:3]:
        closer = np.linspace(taus[i - 1], taus[i + 1], 200)
        near = function(closer)
        j = int(np.argmin(near))
        if near[j] < least:
            least, where = float(near[j]), float(closer[j])
    return least, where


# --- oscillator, modes ----------------------------------------------------------------------


def response(damping: float, stiffness: float, tau: float) -> tuple[mpf, mpf, mpf]:
    """C, S and S' of x'' + 2 a x' + w x = 0, straight from their definitions."""
    a, w, t = mpf(damping), mpf(stiffness), mpf(tau)
    root = mp.sqrt(mpc(a * a - w))
    sine = mp.exp(-a * t) * (t if root == 0 else mp.sinh(root * t) / root)
    sine1 = mp.exp(-a * t) * mp.cosh(root * t) - a * sine
    cosine = sine1 + 2 * a * sine
    return mp.re(cosine), mp.re(sine), mp.re(sine1)


def cycle(times: Sequence[float], takeoffs: Sequence[float], tolerance: float = 1e-6) -> tuple[int, int]:
    """(bounces, plate periods) of the shortest cycle over the last half, seen three times; or (0, 0).

    `takeoffs` are phases since the start, not modulo anything.
    """
    n = len(times)
    for bounces in range(1, n // 3 + 1):
        checked = range(n - max(n // 2, 2 * bounces), n)
        turns = {round((takeoffs[i] - takeoffs[i - bounces]) / (2.0 * math.pi)) for i in checked}
        periods = min(turns)
        if len(turns) == 1 and periods >= 1 and all(
            abs(times[i] - times[i - bounces]) <= tolerance
            and abs(takeoffs[i] - takeoffs[i - bounces] - 2.0 * math.pi * periods) <= tolerance
            for i in checked
        ):  # fmt: skip
            return bounces, periods
    return 0, 0
