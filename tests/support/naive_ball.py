"""A slow, obvious twin of the ball: it falls, and is looked at everywhere.

gap'' = cos(phi) - 1/Gamma in flight; it leaves the plate again at -epsilon times the velocity it landed
with; it rests while 1/Gamma - cos(phi) > 0 and takes off where that is zero.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpf
from naive import SLOWEST_HOP, Flown
from scipy.optimize import brentq

TWO_PI = 2.0 * math.pi

#: Looks at a flight in every rad.
LOOKS = 1000


class Fall(NamedTuple):
    """A flight by where and how it began."""

    gamma: float
    phi: float
    gap: float
    gap1: float

    def gaps(self, tau):
        """The gap after tau rad, a number or an array, without cancellation where tau is small."""
        lost = np.where(
            np.abs(tau) < 0.1, tau**3 / 6.0 * (1.0 - tau**2 / 20.0 * (1.0 - tau**2 / 42.0)), tau - np.sin(tau)
        )
        plate = 2.0 * math.cos(self.phi) * np.sin(0.5 * tau) ** 2 - math.sin(self.phi) * lost
        return self.gap + self.gap1 * tau + plate - 0.5 * tau**2 / self.gamma

    def exactly(self, tau: float) -> tuple[float, float]:
        """Gap and gap' to 80 digits, rounded once."""
        with mp.workdps(80):
            t, phi, gap1 = mpf(tau), mpf(self.phi), mpf(self.gap1)
            fall = (gap1 - mp.sin(phi)) * t - t * t / (2 * mpf(self.gamma))
            gap = mpf(self.gap) + fall + mp.cos(phi) - mp.cos(phi + t)
            slope = gap1 - t / mpf(self.gamma) + mp.sin(phi + t) - mp.sin(phi)
            return float(gap), float(slope)

    def landing(self) -> float:
        """The first time at which the gap is zero again, by looking `LOOKS` times a rad, more at first."""
        start = 1e-3 * min(self.gap1, 1.0) if self.gap1 > SLOWEST_HOP else 1e-3
        taus = np.append(np.geomspace(start, 0.5, 400), 0.5 + np.arange(1, 7 * LOOKS) / LOOKS)
        while True:
            below = np.flatnonzero(self.gaps(taus) < 0.0)
            if len(below):
                high = below[0]
                return float(
                    brentq(self.gaps, taus[high - 1] if high else 0.5 * start, taus[high], xtol=1e-15)
                )
            taus = taus[-1] + np.arange(0, 7 * LOOKS) / LOOKS


def trajectory(gamma: float, epsilon: float, periods: int) -> Iterator[Flown]:
    """Every flight from rest that takes off and lands within some plate periods, hop by hop."""
    phi, hop, end = 0.0, 0.0, TWO_PI * periods
    lift = math.acos(1.0 / gamma) if gamma > 1.0 else 0.0
    while True:
        phase = math.fmod(phi, TWO_PI)
        pressed = not (phase < lift or phase >= TWO_PI - lift)
        if hop < SLOWEST_HOP and pressed:
            if lift == 0.0:
                return
            phi, hop = phi + TWO_PI - lift - phase, 0.0
        fall = Fall(gamma, math.fmod(phi, TWO_PI), 0.0, hop)
        time = fall.landing()
        if phi + time > end:
            return
        yield Flown(phi, time)
        phi, hop = phi + time, -epsilon * fall.exactly(time)[1]
