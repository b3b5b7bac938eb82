"""The branch of cycles with one flight in k plate periods, in closed form (docs/hysteresis.md).

The spring takes off, flies for T rad and sticks for 2 pi k - T. Given T, four conditions are linear in the
elongation q0 and its velocity v0 at take-off and in c = Gamma cos(phi0), s = Gamma sin(phi0): n = 0 at
take-off, gap = 0 at landing, and q and v return to their values. So an array of T gives the whole branch,
with its unstable parts. Stability depends on the times alone.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.spring import STEP, Array, Spring, flight, free, stuck

TWO_PI: Final = 2.0 * math.pi


class Orbit(NamedTuple):
    """Cycles at take-off and at landing, in units of g/omega**2 and rad; arrays (n,)."""

    c: Array  # Gamma cos(phi0)
    s: Array  # Gamma sin(phi0)
    q0: Array  # elongation at take-off
    v0: Array  # its velocity
    impact: Array  # gap' before landing, < 0
    q_land: Array  # elongation after landing
    v_land: Array  # its velocity after landing
    det: Array  # of the linear system; the other fields times det are finite where Gamma is infinite


class Floquet(NamedTuple):
    """Trace and determinant of the tangent map of one cycle, and their derivatives by T; arrays (n,)."""

    trace: Array
    det: Array
    trace1: Array
    det1: Array


def orbit(k: Spring, periods: int, t: Array) -> Orbit:
    """The cycles whose flight takes t (n,) rad, 0 < t < 2 pi periods. Analytic in t, Omega and xi."""
    b, w = k.dashpot, k.stiffness
    fly, stick = flight(k, t), stuck(k, TWO_PI * periods - t)
    f = fly.free
    # Each quantity is x[0] + x[1] c + x[2] v0. The gap without its t**2 terms, which n = 0 removes:
    # gap(t) = c cos_rest - s sin_rest + (1 - c) s_int_rest + w v0 s_int2
    zero, one = np.zeros_like(t), np.ones_like(t)
    s = np.array([fly.s_int_rest, fly.cos_rest - fly.s_int_rest, w * fly.s_int2]) / fly.sin_rest
    c, v0 = np.array([zero, one, zero]), np.array([zero, zero, one])
    q0 = (np.array([one, -one, zero]) - b * v0) / w
    impact = np.array([fly.s_rest, -fly.sin_rest - fly.s_rest, w * fly.s_int]) - fly.versine * s
    longer = v0 * f.s - q0 * f.versine
    q_land, v_land = q0 * f.c + v0 * f.s, q0 * f.c1 + v0 * f.s1 + impact
    # in contact q is a driven motion, here at landing, plus a free motion h; turn: of the former during T
    re, im = k.q_re * fly.cos - k.q_im * fly.sin, k.q_re * fly.sin + k.q_im * fly.cos
    turn_re, turn_im = k.q_re * fly.versine + k.q_im * fly.sin, k.q_re * fly.sin - k.q_im * fly.versine
    h0 = q_land + np.array([one / w, zero, zero]) - re * c + im * s
    h1 = v_land + im * c + re * s
    x = longer + turn_re * c + turn_im * s - stick.versine * h0 + stick.s * h1
    y = stick.c1 * h0 + stick.s1 * h1 - v0 - k.q_im * c - k.q_re * s
    det = x[1] * y[2] - x[2] * y[1]
    a, v = (x[2] * y[0] - x[0] * y[2]) / det, (x[0] * y[1] - x[1] * y[0]) / det
    c, s, q0, v0, impact, q_land, v_land = (
        z[0] + z[1] * a + z[2] * v for z in (c, s, q0, v0, impact, q_land, v_land)
    )
    return Orbit(c, s, q0, v0, impact, q_land, v_land, det)


def floquet(k: Spring, periods: int, t: Array) -> Floquet:
    """Stability of the cycles whose flight takes t (n,) rad: of M = M_stuck(2 pi periods - t) B(t).

    M is the tangent map at fixed phase from take-off to take-off. A landing that sticks maps (dq, dv, dgap,
    dgap') to (dq + dgap, dv + dgap' - b dgap); a take-off from sticking is the identity. M contains neither
    Gamma nor the plate's motion. Analytic in t, Omega and xi.
    """
    b, w = k.dashpot, k.stiffness
    f, m = free(b, 2.0 * w, t), stuck(k, TWO_PI * periods - t)
    c2, s2 = -2.0 * b * f.c1 - 2.0 * w * f.c, -2.0 * b * f.s1 - 2.0 * w * f.s
    # B and its derivative by t
    b00, b01 = 0.5 * (1.0 + f.c), 0.5 * (t + f.s)
    b10, b11 = 0.5 * (f.c1 + b * (f.c - 1.0)), 0.5 * (1.0 + f.s1 - b * (t - f.s))
    d00, d01 = 0.5 * f.c1, 0.5 * (1.0 + f.s1)
    d10, d11 = 0.5 * (c2 + b * f.c1), 0.5 * (s2 - b * (1.0 - f.s1))
    # d/dt of M_stuck(2 pi k - t) is -M_stuck'
    m_c2, m_s2 = -b * m.c1 - w * m.c, -b * m.s1 - w * m.s
    trace = m.c * b00 + m.s * b10 + m.c1 * b01 + m.s1 * b11
    trace1 = m.c * d00 + m.s * d10 + m.c1 * d01 + m.s1 * d11
    trace1 = trace1 - (m.c1 * b00 + m.s1 * b10 + m_c2 * b01 + m_s2 * b11)
    damped = np.exp(-b * (TWO_PI * periods - t))  # the determinant of M_stuck
    inner = b00 * b11 - b01 * b10
    inner1 = d00 * b11 + b00 * d11 - d01 * b10 - b01 * d10
    return Floquet(trace, damped * inner, trace1, damped * (inner1 + b * inner))


def multipliers(trace: NDArray[np.float64], det: NDArray[np.float64]) -> NDArray[np.complex128]:
    """The roots (n, 2) of mu**2 - trace mu + det, the larger modulus first; of complex pairs Im < 0 first."""
    root = np.sqrt(np.asarray(0.25 * trace * trace - det, np.complex128))
    large = 0.5 * trace + np.where((trace < 0.0) | (root.imag > 0.0), -1.0, 1.0) * root
    with np.errstate(divide="ignore", invalid="ignore"):
        small = np.where(root.imag > 0.0, np.conj(large), np.where(large == 0.0, 0.0, det / large))
    return np.stack([large, small], axis=-1)


def stable(trace: NDArray[np.float64], det: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether both multipliers lie inside the unit circle (n,), by Jury's conditions."""
    return (1.0 - trace + det > 0.0) & (1.0 + trace + det > 0.0) & (det < 1.0)


def gamma_and_slope(k: Spring, periods: int, t: Array) -> tuple[Array, Array]:
    """Gamma and dGamma/dT (n,) of the cycles whose flight takes t (n,) rad, t real."""
    x = orbit(k, periods, t + 1j * STEP)
    gamma = np.sqrt(x.c * x.c + x.s * x.s)
    return gamma.real, gamma.imag / STEP
