"""The free motions of the spring, for arrays of times and for derivatives by the complex step.

Every function here is analytic in the time, in Omega and in xi: the imaginary part of f(x + i h), over h, is
f' without cancellation (`STEP`). Uses numpy alone, so that nothing has to be compiled.

Phase phi = omega t in rad. The closed forms of this package have lengths in units of g/omega**2, where the
weight is one and the equations of an orbit are linear. Results are in plate amplitudes.
"""

import math
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.stopping import check

#: float64, or complex128 in a complex step.
Array = NDArray[Any]
Number = float | complex

#: h of the complex step. Its square is far below rounding, and above the smallest double.
STEP: Final = 1e-40

#: Below this rate * time the integrals of a flight are power series: 24 terms leave 1/24! = 2e-24.
SERIES_BELOW: Final = 1.0
TERMS: Final = 24

#: Below this |D| t**2, D being the discriminant, sine and exponentials are series in D, which are smooth
#: through critical damping: nine terms leave 0.25**9/19! = 3e-23.
_CRITICAL: Final = 0.25
_CRITICAL_TERMS: Final = 9

#: From this discriminant over the stiffness on an integral of a flight is the sum of two exponentials': its
#: other terms nearly cancel beside a stiff dashpot.
_STIFF: Final = 10.0


class Spring(NamedTuple):
    """The constants of a spring under a plate of frequency Omega (docs/model.md, section 3)."""

    omega: Number
    xi: Number
    dashpot: Number  # b = 2 xi/Omega
    stiffness: Number  # w = 1/Omega**2
    q_re: Number  # the driven elongation in contact is -w**-1/Gamma + Re(Q e^{i phi}), Q = 1/(w - 1 + i b)
    q_im: Number


class Free(NamedTuple):
    """x(t) = x(0) c + x'(0) s of a damped oscillator, with the time derivatives of c and s."""

    c: Array
    s: Array
    c1: Array
    s1: Array
    versine: Array  # 1 - c


class Flight(NamedTuple):
    """Functions of the time t whose combination is the gap in flight; accurate as t -> 0."""

    free: Free  # of the elongation in flight
    s_int: Array  # integral of s from 0 to t, about t**2/2
    s_int2: Array  # and the integral of that, about t**3/6
    s_rest: Array  # s - t
    s_int_rest: Array  # s_int - t**2/2
    sin_rest: Array  # t - sin t
    cos_rest: Array  # 1 - cos t - t**2/2
    versine: Array  # 1 - cos t
    sin: Array
    cos: Array


def spring(omega: Number, xi: Number) -> Spring:
    """The constants of a spring; omega and xi may be complex in a complex step."""
    b, w = 2.0 * xi / omega, 1.0 / (omega * omega)
    size = (w - 1.0) * (w - 1.0) + b * b
    return Spring(omega, xi, b, w, (w - 1.0) / size, -b / size)


def free(a: Number, w: Number, t: Array) -> Free:
    """The free motion of x'' + 2 a x' + w x = 0 at times t >= 0, underdamped, critical or overdamped.

    Every closed form calls this, so that it can be stopped here. Raises `stopping.Stopped`.
    """
    check()
    d = a * a - w
    decay = np.exp(-a * t)
    square = d * t * t
    near = np.abs(square) < _CRITICAL
    if np.real(d) < 0.0:
        root = np.sqrt(-d)
        angle = root * t
        s = decay * np.sin(angle) / root
        c = decay * np.cos(angle) + a * s
        s1, versine = c - 2.0 * a * s, 1.0 - c
    else:
        root = np.sqrt(d)
        slow = -w / (a + root)
        tail = np.exp(slow * t)
        s = tail * -np.expm1(-2.0 * root * t) / (2.0 * root if d != 0.0 else 1.0)
        c = tail - slow * s
        # a stiff dashpot makes s1 and 1 - c small
        s1, versine = slow * s + np.exp((slow - 2.0 * root) * t), slow * s - np.expm1(slow * t)
    if near.any():
        x = square[near]
        sine, cosine = np.ones_like(x), np.ones_like(x)
        term = np.ones_like(x)
        for n in range(1, _CRITICAL_TERMS + 1):
            term = term * x / (2 * n * (2 * n - 1))
            cosine = cosine + term
            sine = sine + term / (2 * n + 1)
        s[near] = decay[near] * t[near] * sine
        c[near] = decay[near] * cosine + a * s[near]
        s1[near], versine[near] = c[near] - 2.0 * a * s[near], 1.0 - c[near]
    return Free(c, s, -w * s, s1, versine)


def stuck(k: Spring, t: Array) -> Free:
    """The free elongation after t rad in contact, q'' + b q' + w q = 0."""
    return free(0.5 * k.dashpot, k.stiffness, t)


def flight(k: Spring, t: Array) -> Flight:
    """The elongation after t rad in flight, q'' + 2 b q' + 2 w q = 0, and its integrals."""
    b, w = k.dashpot, k.stiffness
    f = free(b, 2.0 * w, t)
    s_int = f.versine / (2.0 * w)
    d = b * b - 2.0 * w
    if np.real(d) < _STIFF * np.real(w):
        s_int2 = (t - f.s - 2.0 * b * s_int) / (2.0 * w)
    else:
        root = np.sqrt(d)
        fast = b + root
        s_int2 = t * t * (_curved(-2.0 * w / fast * t) - _curved(-fast * t)) / (2.0 * root)
    s_rest, s_int_rest = f.s - t, s_int - 0.5 * t * t
    near = np.real(t) * max(np.sqrt(2.0 * abs(w)), 2.0 * abs(b)) < SERIES_BELOW
    if near.any():
        x = t[near]
        s_rest[near], s_int_rest[near], double = _summed(x, 2, _response_series(b, w))
        s_int[near] = 0.5 * x * x + s_int_rest[near]
        s_int2[near] = x * x * x / 6.0 + double
    sin, cos = np.sin(t), np.cos(t)
    half = np.sin(0.5 * t)
    versine = 2.0 * half * half
    sin_rest, cos_rest = t - sin, versine - 0.5 * t * t
    near = np.real(t) < SERIES_BELOW
    if near.any():
        sin_rest[near], cos_rest[near] = _summed(t[near], 3, _CIRCULAR_SERIES)
    return Flight(f, s_int, s_int2, s_rest, s_int_rest, sin_rest, cos_rest, versine, sin, cos)


def _curved(x: Array) -> Array:
    """(exp(x) - 1 - x)/x**2, Re x <= 0."""
    near = np.real(x) > -SERIES_BELOW
    small, large = np.where(near, x, 0.0), np.where(near, -1.0, x)
    series = np.zeros_like(x)
    for n in range(TERMS, 1, -1):
        series = (1.0 + small * series) / n
    return np.where(near, series, (np.expm1(large) - large) / (large * large))


@lru_cache(maxsize=64)
def _response_series(b: Number, w: Number) -> Array:
    """Coefficients (m, 3) of t**2, t**3, ... in s - t, in its integral, and in the integral of that."""
    before, last, factorial = 0.0 * b, 1.0 + 0.0 * b, 1.0
    rows = []
    for n in range(2, TERMS):
        before, last = last, -2.0 * b * last - 2.0 * w * before  # the n-th derivative of s at zero
        factorial *= n
        rows.append(last / factorial)
    order = np.arange(2.0, TERMS)
    series = np.zeros((len(order) + 2, 3), np.asarray(rows).dtype)
    series[:-2, 0] = rows
    series[1:-1, 1] = rows / (order + 1.0)
    series[2:, 2] = series[1:-1, 1] / (order + 2.0)
    return series


def _circular_series() -> Array:
    """Coefficients (m, 2) of t**3, t**4, ... in t - sin t and in 1 - cos t - t**2/2."""
    terms = [(-1.0) ** (n // 2 + 1) / math.factorial(n) for n in range(3, TERMS)]
    return np.array([[a, 0.0] if n % 2 else [0.0, a] for n, a in enumerate(terms, 3)])


_CIRCULAR_SERIES: Final = _circular_series()


def _summed(t: Array, lowest: int, series: Array) -> Array:
    """Power series (f, n) at times t (n,), from their coefficients (m, f), the first of t**lowest."""
    power = np.empty((len(series), len(t)), t.dtype)
    power[0], power[1:] = t**lowest, t
    return np.asarray(np.einsum("mf,mn->fn", series, np.multiply.accumulate(power)))
