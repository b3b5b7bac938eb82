"""A slow, obvious twin of `stepped`: one time step after another, each the scheme as it is written down.

    v' = v + (1 - m) h a(x, v, phi)      x+ = x + h v'      v+ = v' + m h a(x+, v+, phi + h)

with m = 1/2 (velocity Verlet, its last line solved for v+) or 0 (semi-implicit Euler). The step in which a
contact or flight ends is shortened to end there, and another one leads back to the grid of phases; what
ends within that one ends with it. Plain steps are never shortened.
"""

import math

import numpy as np
from naive import Flown, Setting, damping_for

#: Parts of a step that bisection tells apart.
FINEST = 1e-15

TWO_PI = 2.0 * math.pi


class Stepper:
    """One setting, stepped `number` times in every plate period."""

    def __init__(self, s: Setting, number: int, m: float) -> None:
        self.s, self.number, self.m, self.h = s, number, m, TWO_PI / number
        self.zeta = damping_for(s.restitution, s.adhesive)

    def forces(self, x: np.ndarray, phi: float, pressed: bool) -> tuple:
        """The acceleration without damping, and the matrix of the damping."""
        d, w, b = self.s.penetration, self.s.w, self.s.b
        kappa, beta = (1.0 / d**2, 2.0 * self.zeta / d) if pressed else (0.0, 0.0)
        stiff = np.array([[kappa, -w], [-kappa, 2.0 * w]])
        drive = np.array([math.cos(phi) - 1.0 / self.s.gamma, 0.0])
        return drive - stiff @ x, np.array([[beta, -b], [-beta, 2.0 * b]])

    def step(self, x: np.ndarray, v: np.ndarray, phi: float, h: float, pressed: bool, then: bool) -> tuple:
        """(gap, q) and their velocities after a step of h rad from phi; `then`: pressed at its end."""
        push, drag = self.forces(x, phi, pressed)
        half = v + (1.0 - self.m) * h * (push - drag @ v)
        x = x + h * half
        push, drag = self.forces(x, phi + h, then)
        return x, np.linalg.solve(np.eye(2) + self.m * h * drag, half + self.m * h * push)

    def lasts(self, x: np.ndarray, v: np.ndarray, flying: bool) -> bool:
        """Whether the contact or flight goes on."""
        lead = 0.0 if self.s.adhesive else 2.0 * self.zeta * self.s.penetration
        force = x[0] + lead * v[0]
        return bool(x[0] >= 0.0 or force >= 0.0) if flying else bool(force <= 0.0)

    def flights(self, periods: int) -> list[Flown]:
        """Every flight from rest that takes off and lands within some plate periods."""
        gap, _, q, _ = self.s.at_rest()
        x, v, phi, flying, took_off = np.array([gap, q]), np.zeros(2), 0.0, False, 0.0
        flights, n, first = [], 1, True
        while n <= self.number * periods:
            h = n * self.h - phi
            after = self.step(x, v, phi, h, not flying, not flying)
            if self.lasts(*after, flying):
                (x, v), phi, n, first = after, n * self.h, n + 1, False
                continue
            low, high = h if first else 0.0, h
            while high - low > FINEST * self.h:
                middle = 0.5 * (low + high)
                if middle in (low, high):
                    break
                goes_on = self.lasts(*self.step(x, v, phi, middle, not flying, not flying), flying)
                low, high = (middle, high) if goes_on else (low, middle)
            (x, v), phi = self.step(x, v, phi, high, not flying, not flying), phi + high
            if flying:
                flights.append(Flown(took_off, phi - took_off))
                x[0], v[0] = min(x[0], 0.0), min(v[0], 0.0)
            else:
                took_off = phi
                if self.s.adhesive:
                    x[0], v[0] = max(x[0], 0.0), max(v[0], 0.0)
            flying, n, first = not flying, math.floor(phi / self.h + 1e-9) + 1, True
        return flights

    def plain_flights(self, periods: int) -> list[Flown]:
        """The same with no step shortened: the plate presses at their ends if the state says so."""
        gap, _, q, _ = self.s.at_rest()
        x, v, pressed, took_off, flights = np.array([gap, q]), np.zeros(2), True, 0.0, []
        for n in range(self.number * periods):
            steps = [self.step(x, v, n * self.h, self.h, pressed, then) for then in (True, False)]
            touches = not self.lasts(*steps[0], True)
            x, v = steps[0] if touches else steps[1]
            end = (n + 1) * self.h
            if touches and not pressed:
                flights.append(Flown(took_off, end - took_off))
            elif pressed and not touches:
                took_off = end
            pressed = touches
        return flights
