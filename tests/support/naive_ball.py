"""A slow, obvious twin of the ball in flight: gap'' = cos(phi) - 1/Gamma."""

import math
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpf


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
