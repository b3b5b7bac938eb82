"""Branches (1,k) on a dense grid of T by products of matrix exponentials; nothing of `kernel.branches`.

The state is (q, v, gap, gap', c, s, 1) with c + i s = Gamma e^{i phi} and lengths in g/omega**2. Flight and
contact are linear in it, so the flow over the grid's j steps is the j-th power of that over one.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm


class Found(NamedTuple):
    """An event by a sign change between neighbours of the grid."""

    kind: str
    flight_time: float
    gamma: float
    margin: float  # of the orbit's conditions, relative to the size of what they ask of: > 0: admissible


def _generators(omega: float, xi: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of flight and contact (7, 7), and the matrix of a landing."""
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    flight, contact = np.zeros((7, 7)), np.zeros((7, 7))
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


def events(omega: float, xi: float, periods: int, below: float, points: int = 20_000) -> list[Found]:
    """Folds, flips and Neimark-Sacker points with Gamma < below, by flight time."""
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    step = 2.0 * math.pi * periods / points
    generator, stuck, landing = _generators(omega, xi)
    fly, stick = _powers(generator, step, points), _powers(stuck, step, points)
    at = np.arange(1, points)
    # from take-off with gap = gap' = 0 over flight, landing and contact
    down = fly[at]
    whole = stick[points - at] @ (landing @ down)
    free, rest = [0, 1, 4, 5], 6
    system = np.zeros((len(at), 4, 4))
    right = np.zeros((len(at), 4))
    system[:, 0] = w, b, 1.0, 0.0
    right[:, 0] = 1.0  # n = 1 - c - b v - w q = 0
    system[:, 1] = down[:, 2, free]
    right[:, 1] = -down[:, 2, rest]
    for row, i in ((2, 0), (3, 1)):
        system[:, row] = whole[:, i][:, free]
        system[:, row, i] -= 1.0
        right[:, row] = -whole[:, i, rest]
    start = np.linalg.solve(system, right[..., None])[..., 0]
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
        ("neimark-sacker", np.where(np.abs(trace) < 2.0, det - 1.0, np.nan)),
    ):
        for i in np.flatnonzero(test[:-1] * test[1:] < 0.0):
            part = test[i] / (test[i] - test[i + 1])
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
