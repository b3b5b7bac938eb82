"""The minima of the descending threshold over Omega: landings that take no energy (docs/hysteresis.md).

Gamma(T, Omega) of a (1,k) branch has a fold where its derivative by T is zero. The lowest fold over Omega, a
tip, is where the derivative by Omega is zero too. In the limit xi = 0, tips are springs that hop on a plate
at rest and land with the velocity of the plate.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from kernel.cycles.closed_form import orbit
from kernel.cycles.roots import Floats
from kernel.cycles.spring import STEP, spring

#: Most steps of Newton's method, and the relative size of the last one.
_NEWTON: Final = 40
_CONVERGED: Final = 1e-12

#: Step of differences of exact first derivatives; its square is the relative error of second ones.
_DIFFERENCE: Final = 1e-5

#: Largest damping at which a tip is sought from the limit xi -> 0 without steps in xi.
_FIRST_XI: Final = 0.01


class Tip(NamedTuple):
    """A minimum over Omega of the Gamma at which a branch folds."""

    omega: float
    xi: float
    flight_time: float  # rad
    gamma: float


def soft_landing(j: int, periods: int) -> tuple[float, float]:
    """Omega and the flight time (rad) of the j-th hop without loss, xi = 0, once in `periods` plate periods.

    With y the j-th root of tan y = y, the flight takes sqrt(2) y/omega_0 and the contact
    2 (pi - atan(y/sqrt(2)))/omega_0.
    """
    y = (j + 0.5) * math.pi
    for _ in range(_NEWTON):  # tan y = y as sin y = y cos y, next to a zero of the cosine
        y -= (math.sin(y) - y * math.cos(y)) / (y * math.sin(y))
    flight, contact = math.sqrt(2.0) * y, 2.0 * (math.pi - math.atan(y / math.sqrt(2.0)))
    omega = 2.0 * math.pi * periods / (flight + contact)
    return omega, omega * flight


def tip(j: int, periods: int, xi: float) -> Tip:
    """The tip that the j-th hop without loss becomes at damping xi > 0."""
    omega, t = soft_landing(j, periods)
    u = np.array([t, omega])
    dampings = np.linspace(_FIRST_XI, xi, math.ceil(xi / _FIRST_XI)) if xi > _FIRST_XI else np.array([xi])
    for damping in dampings:
        u = _newton(partial(_square_slopes, float(damping), periods), u)
    return Tip(float(u[1]), xi, float(u[0]), float(_slopes(u[0], u[1], xi, periods)[0]))


def deepest(j: int, periods: int, xi: float) -> Tip:
    """Where the fold of the j-th tip's branch lies lowest, relative to Gamma_th."""

    def slopes(v: Floats) -> Floats:
        gamma, by_t, by_omega = _slopes(v[0], v[1], xi, periods)
        above, slope = _threshold(v[1], xi)
        return np.array([gamma * by_t, gamma * (by_omega - gamma * slope / above)])

    first = tip(j, periods, xi)
    t, omega = _newton(slopes, np.array([first.flight_time, first.omega]))
    return Tip(float(omega), xi, float(t), float(_slopes(t, omega, xi, periods)[0]))


def end_of_hysteresis(j: int, periods: int) -> Tip:
    """The fold of the j-th tip's branch at the largest damping at which it still lies below Gamma_th."""
    first = tip(j, periods, 0.05)

    def touching(v: Floats) -> Floats:
        t, omega, xi = v
        gamma, by_t, by_omega = _slopes(t, omega, xi, periods)
        above, slope = _threshold(omega, xi)
        return np.array([gamma - above, by_t, by_omega - slope])

    t, omega, xi = _newton(touching, np.array([first.flight_time, first.omega, first.xi]))
    return Tip(float(omega), float(xi), float(t), float(_slopes(t, omega, xi, periods)[0]))


def _square_slopes(xi: float, periods: int, v: Floats) -> Floats:
    """The derivatives of Gamma**2/2 by (T, Omega) = v: smooth also where xi and Gamma go to zero."""
    gamma, by_t, by_omega = _slopes(v[0], v[1], xi, periods)
    return np.array([gamma * by_t, gamma * by_omega])


def _slopes(t: float, omega: float, xi: float, periods: int) -> Floats:
    """Gamma and its derivatives by T and Omega (3,)."""
    by_t = _gamma(t + 1j * STEP, omega, xi, periods)
    by_omega = _gamma(t + 0j, omega + 1j * STEP, xi, periods)
    return np.array([by_t.real, by_t.imag / STEP, by_omega.imag / STEP])


def _gamma(t: complex, omega: complex, xi: float, periods: int) -> complex:
    x = orbit(spring(omega, xi), periods, np.array([t]))
    return complex(np.sqrt(x.c * x.c + x.s * x.s)[0])


def _threshold(omega: float, xi: float) -> tuple[float, float]:
    """Eq. 25 and its derivative by Omega."""
    w = (omega + 1j * STEP) ** 2
    value = 2.0 * np.sqrt(((1.0 - w) ** 2 + 4.0 * xi * xi * w) / ((2.0 - w) ** 2 + 16.0 * xi * xi * w))
    return float(value.real), float(value.imag / STEP)


def _newton(f: Callable[[Floats], Floats], u: Floats) -> Floats:
    """The root of f next to u."""
    for _ in range(_NEWTON):
        h = _DIFFERENCE * u
        slope = np.array([(f(u + step) - f(u - step)) / 2.0 for step in np.diag(h)]).T / h  # columns
        move = np.linalg.solve(slope, f(u))
        u = u - move
        if np.all(np.abs(move) < _CONVERGED * u):
            return u
    raise ArithmeticError("no such tip")
