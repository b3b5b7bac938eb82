"""Each phase of the twin in `naive` solved to 80 digits: motion, energy and phase functions at any time.

In flight and in contact the equations of `naive` are linear: a sum of exponentials, worked out from the roots
of its characteristic polynomial so precisely that no cancellation is ever visible.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpc, mpf
from naive import Setting, State

mp.dps = 80

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
    rotating = amplitude * mp.expj(mpf(phi)) / 2
    return Sum([rotating, mp.conj(rotating)], [mpc(0, 1), mpc(0, -1)])


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
    gained = float(motion.force.integral(lower, tau))
    return gained - lost, lost + abs(gained)


# --- first roots by looking everywhere ------------------------------------------------------


def instants(motion: Exact, tau: float, limit: int) -> np.ndarray:
    """Instants to examine: a hundred in every turn of the fastest ringing, or `limit` times in all."""
    if motion.gap.delicate(tau) or motion.force.delicate(tau):
        limit = min(limit, 300)
    turns = tau * motion.fastest() / (2.0 * math.pi)
    even = np.linspace(0.0, tau, min(limit, 200 + int(100.0 * turns)))
    return np.unique(np.concatenate([even, tau * np.logspace(-12, 0, min(limit // 3, 300))]))


def lowest(function: Callable[[np.ndarray], np.ndarray], taus: np.ndarray) -> tuple[float, float]:
    """The minimum and where it is, refined around each of the smallest samples."""
    values = function(taus)
    inner = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1
    best = int(np.argmin(values))
    minimum, where = float(values[best]), float(taus[best])
    for i in inner[np.argsort(values[inner])][:3]:
        closer = np.linspace(taus[i - 1], taus[i + 1], 200)
        near = function(closer)
        j = int(np.argmin(near))
        if near[j] < minimum:
            minimum, where = float(near[j]), float(closer[j])
    return minimum, where


# --- an oscillator --------------------------------------------------------------------------


def response(damping: float, stiffness: float, tau: float) -> tuple[mpf, mpf, mpf]:
    """C, S and S' of x'' + 2 a x' + w x = 0, straight from their definitions."""
    a, w, t = mpf(damping), mpf(stiffness), mpf(tau)
    root = mp.sqrt(mpc(a * a - w))
    sine = mp.exp(-a * t) * (t if root == 0 else mp.sinh(root * t) / root)
    sine1 = mp.exp(-a * t) * mp.cosh(root * t) - a * sine
    cosine = sine1 + 2 * a * sine
    return mp.re(cosine), mp.re(sine), mp.re(sine1)
