"""Branches (1,k) on a dense grid of T by products of matrix exponentials; nothing of `kernel.cycles`.

The state is (q, v, gap, gap', c, s, 1) with c + i s = Gamma e^{i phi} and lengths in g/omega**2. Flight and
contact are linear in it, so the flow over the grid's j steps is the j-th power of that over one.
"""

import math
from typing import Any, NamedTuple

import mpmath
import numpy as np
from scipy.linalg import expm


class Found(NamedTuple):
    """An event by a sign change between neighbours of the grid."""

    kind: str
    flight_time: float
    gamma: float
    margin: float  # least of the orbit's conditions, relative to their sizes; > 0: admissible


def _generators(b: Any, w: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The generators (7, 7) of flight and contact, and the matrix of a landing."""
    flight, contact = np.zeros((7, 7), type(b)), np.zeros((7, 7), type(b))
    for m in (flight, contact):
        m[0, 1] = 1.0
        m[4, 5], m[5, 4] = -1.0, 1.0
    flight[1, :2] = -2.0 * w, -2.0 * b
    flight[2, 3] = 1.0
    flight[3, :2], flight[3, 4], flight[3, 6] = (w, b), 1.0, -1.0
    contact[1, :2], contact[1, 4], contact[1, 6] = (-w, -b), 1.0, -1.0
    landing = np.eye(7)
    landing[1, 3], landing[3, 3] = 1.0, 0.0
    return flight, contact, landing


def _powers(generator: np.ndarray, step: float, count: int) -> np.ndarray:
    """Flows over 0, 1, ... count steps (count + 1, n, n)."""
    powers = np.empty((count + 1, *generator.shape))
    powers[0], powers[1] = np.eye(len(generator)), expm(generator * step)
    have = 1
    while have < count:
        more = min(have, count - have)
        powers[have + 1 : have + more + 1] = powers[1 : more + 1] @ powers[have]
        have += more
    return powers


def _starts(down: np.ndarray, whole: np.ndarray, b: float, w: float) -> np.ndarray:
    """(q, v, c, s) at take-off (n, 4) of cycles with these flows (n, 7, 7) over a flight and a cycle."""
    system, right = _conditions(down, whole, b, w)
    return np.asarray(np.linalg.solve(system, right[..., None])[..., 0])


def _conditions(down: np.ndarray, whole: np.ndarray, b: Any, w: Any) -> tuple[np.ndarray, np.ndarray]:
    """The linear system (n, 4, 4) of (q, v, c, s) at take-off, and its right side (n, 4)."""
    free, rest = [0, 1, 4, 5], 6
    system = np.zeros((len(down), 4, 4), down.dtype)
    right = np.zeros((len(down), 4), down.dtype)
    system[:, 0] = w, b, 1.0, 0.0
    right[:, 0] = 1.0  # n = 1 - c - b v - w q = 0
    system[:, 1] = down[:, 2, free]
    right[:, 1] = -down[:, 2, rest]
    for row, i in ((2, 0), (3, 1)):
        system[:, row] = whole[:, i][:, free]
        system[:, row, i] -= 1.0
        right[:, row] = -whole[:, i, rest]
    return system, right


def takeoff(omega: float, xi: float, periods: int, flight_time: float) -> np.ndarray:
    """(q, v, c, s) at take-off of the cycle with one flight time, computed with 50 digits."""
    with mpmath.workdps(50):
        b, w = 2 * mpmath.mpf(xi) / omega, 1 / mpmath.mpf(omega) ** 2
        flight, contact, landing = map(mpmath.matrix, _generators(b, w))
        fly = mpmath.expm(flight * flight_time)
        whole = mpmath.expm(contact * (2 * mpmath.pi * periods - flight_time)) * landing * fly
        down, around = (np.array(m.tolist(), object)[None] for m in (fly, whole))
        system, right = _conditions(down, around, b, w)
        solved = mpmath.lu_solve(mpmath.matrix(system[0]), mpmath.matrix(right[0]))
        return np.array([float(x) for x in solved])


def events(omega: float, xi: float, periods: int, below: float, points: int = 20_000) -> list[Found]:
    """Folds, flips and Neimark-Sacker points with Gamma < below, by flight time."""
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    step = 2.0 * math.pi * periods / points
    generator, stuck, landing = _generators(b, w)
    fly, stick = _powers(generator, step, points), _powers(stuck, step, points)
    at = np.arange(1, points)
    # from take-off with gap = gap' = 0 over flight, landing and contact
    down = fly[at]
    start = _starts(down, stick[points - at] @ (landing @ down), b, w)
    gamma = np.hypot(start[:, 2], start[:, 3])
    # variations: dgap = dgap' = 0 at take-off; the landing moves by -dgap/W, which leaves -b dgap in v
    salted = landing.copy()
    salted[0, 2], salted[1, 2], salted[2:4] = 1.0, -b, 0.0
    tangent = (stick[points - at] @ (salted @ down))[:, :2, :2]
    trace, det = np.trace(tangent, axis1=1, axis2=2), np.linalg.det(tangent)
    found = []
    for kind, test in (
        ("fold", 1.0 - trace + det),
        ("flip", 1.0 + trace + det),
        ("neimark-sacker", det - 1.0),
    ):
        for i in np.flatnonzero(test[:-1] * test[1:] < 0.0):
            part = test[i] / (test[i] - test[i + 1])
            if kind == "neimark-sacker" and abs(trace[i] + part * (trace[i + 1] - trace[i])) >= 2.0:
                continue  # the product of two real multipliers is 1
            here = gamma[i] + part * (gamma[i + 1] - gamma[i])
            if here < below and (at[i] + part) * step > 0.02:
                margin = _margin(fly, stick, landing, start[i], int(at[i]), b, w)
                found.append(Found(kind, float((at[i] + part) * step), float(here), margin))
    return sorted(found, key=lambda event: event.flight_time)


def _margin(
    fly: np.ndarray, stick: np.ndarray, landing: np.ndarray, start: np.ndarray, j: int, b: float, w: float
) -> float:
    """The least of the gap in flight, of n in contact, and of -n' at take-off, relative to their largest."""
    y = np.array([start[0], start[1], 0.0, 0.0, start[2], start[3], 1.0])
    gap = fly[1:j, 2] @ y
    contact = stick[: len(stick) - 1 - j] @ (landing @ fly[j] @ y)
    n = 1.0 - contact[:, 4] - b * contact[:, 1] - w * contact[:, 0]
    slope = y[5] - b * (y[4] - 1.0 - b * y[1] - w * y[0]) - w * y[1]
    parts = [gap.min() / np.abs(gap).max(), -slope / (abs(slope) + 1.0)]
    if len(n) > 2:
        parts.append(n[:-1].min() / np.abs(n).max())
    return float(min(parts))


class Held(NamedTuple):
    """The conditions of n cycles, in plate amplitudes and m A omega**2; arrays (n,)."""

    gap: np.ndarray  # its deepest minimum inside the flight; inf: none
    impact: np.ndarray  # gap' before landing: < 0
    force: np.ndarray  # the deepest minimum of n inside the contact
    landing: np.ndarray  # n after landing: > 0
    takeoff: np.ndarray  # n' at take-off: < 0

    def flight_held(self) -> np.ndarray:
        """Whether the gap is positive in flight, up to DEEP."""
        return np.asarray((self.gap > -DEEP) & (self.impact < 0.0) & (self.takeoff < 0.0))

    def contact_held(self) -> np.ndarray:
        """Whether n is positive in contact, up to DEEP."""
        return np.asarray((self.force > -DEEP) & (self.landing > 0.0) & (self.takeoff < 0.0))


#: Minima less deep than this, in plate amplitudes or m A omega**2, are not decided by samples.
DEEP = 1e-8

#: Flight times computed at a time.
_BLOCK = 1000


def _minimum(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The least minimum of each column (n,) of samples (m, n), by parabolas; inf: none inside."""
    before, here, after = values[:-2], values[1:-1], values[2:]
    turns = (here < before) & (here <= after) & inside[2:]
    with np.errstate(invalid="ignore", divide="ignore"):
        low = here - (after - before) ** 2 / (8.0 * (after - 2.0 * here + before))
    return np.asarray(np.where(turns, low, np.inf).min(axis=0))


def _held(
    start: np.ndarray, landed: np.ndarray, gap: np.ndarray, n: np.ndarray, b: float, w: float,
    impact: np.ndarray,
) -> Held:  # fmt: skip
    """From samples gap, n (m, n), NaN outside, the states at take-off (n, 4) and after landing (n, 7)."""
    q, v, c, s = start.T
    size = np.hypot(c, s)
    press = 1.0 - landed[:, 4] - b * landed[:, 1] - w * landed[:, 0]
    slope = s - b * (c - 1.0 - b * v - w * q) - w * v
    return Held(
        _minimum(gap, np.isfinite(gap)) / size, impact / size, _minimum(n, np.isfinite(n)) / size,
        press / size, slope / size,
    )  # fmt: skip


def held(omega: float, xi: float, periods: int, flight_time: float, samples: int = 4_000) -> Held:
    """The conditions of the cycle with one flight time (1,)."""
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    generator, stuck, landing = _generators(b, w)
    fly = _powers(generator, flight_time / samples, samples)
    stick = _powers(stuck, (2.0 * math.pi * periods - flight_time) / samples, samples)
    start = _starts(fly[-1:], stick[-1:] @ (landing @ fly[-1:]), b, w)
    q, v, c, s = start[0]
    whole = np.array([q, v, 0.0, 0.0, c, s, 1.0])
    down = fly[-1] @ whole
    landed = landing @ down
    y = stick @ landed
    n = 1.0 - y[:, 4] - b * y[:, 1] - w * y[:, 0]
    return _held(start, landed[None], (fly[:, 2] @ whole)[:, None], n[:, None], b, w, down[3:4])


def breaks(
    omega: float, xi: float, periods: int, below: float, points: int = 20_000, every: int = 8
) -> list[tuple[float, float]]:
    """Neighbours among `points` flight times of (1, periods) between which a condition breaks; Gamma < below.

    Samples gap and n at every `every`-th of these times.
    """
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    step = 2.0 * math.pi * periods / points
    generator, stuck, landing = _generators(b, w)
    fly, stick = _powers(generator, step, points), _powers(stuck, step, points)
    sampled = np.arange(0, points, every)
    gap_rows = fly[sampled, 2]
    n_rows = -(stick[sampled, 4] + b * stick[sampled, 1] + w * stick[sampled, 0])
    n_rows[:, 6] += 1.0
    at = np.arange(1, points)
    parts = []
    for first in range(0, len(at), _BLOCK):
        j = at[first : first + _BLOCK]
        down = fly[j]
        start = _starts(down, stick[points - j] @ (landing @ down), b, w)
        zero, one = np.zeros(len(j)), np.ones(len(j))
        y = np.stack([start[:, 0], start[:, 1], zero, zero, start[:, 2], start[:, 3], one])
        end = np.einsum("nij,jn->in", down, y)
        landed = landing @ end
        gap = np.where(sampled[:, None] <= j, gap_rows @ y, np.nan)
        n = np.where(sampled[:, None] <= points - j, n_rows @ landed, np.nan)
        parts.append((np.hypot(start[:, 2], start[:, 3]), *_held(start, landed.T, gap, n, b, w, end[3])))
    gamma, *conditions = (np.concatenate(part) for part in zip(*parts, strict=True))
    whole = Held(*conditions)
    changes = (np.diff(whole.flight_held()) != 0) | (np.diff(whole.contact_held()) != 0)
    changes &= (np.maximum(gamma[:-1], gamma[1:]) < below) & (at[:-1] * step > 0.02)
    return [(float(at[i] * step), float(at[i + 1] * step)) for i in np.flatnonzero(changes)]
