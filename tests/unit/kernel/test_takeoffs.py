"""Take-offs from strongly damped contacts against 120-digit arithmetic (tests/golden/takeoffs.json).

Nonadhesive, zeta from 5 to 5,000: the mass stops within d/(2 zeta) rad, then creeps back at 1/(2 zeta d).
The reference sums the exponentials of the motion, whose rates are the roots of its characteristic
polynomial, and looks for the first zero of n on a grid that is fine beside every rate.

To write the file anew: python tests/unit/kernel/test_takeoffs.py
"""

import json
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp, mpc, mpf
from tables import for_each

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2] / "support"), str(Path(__file__).parents[3])]

from kernel_runs import one_phase
from naive import Setting
from paths import GOLDEN

from kernel.numerics.first_root import ROOT

FILE = GOLDEN / "takeoffs.json"

CONTACTS = 1000
HORIZON = 4.0 * math.pi

#: rad. The error of the kernel's n, a few 1e-16 of its terms, over the least slope below.
TOLERANCE = 1e-11

#: Least |n'| at take-off among the contacts: where n grazes zero its time has fewer digits.
LEAST_SLOPE = 1e-3

#: Half of the contacts last longer than this, rad; most of the others end within the impact.
LONG = 0.1


class Contact(NamedTuple):
    """A contact from its beginning, an impact or a state below the surface with n = 0."""

    gamma: float
    omega: float
    xi: float
    restitution: float
    penetration: float
    phi: float
    gap: float
    gap1: float
    q: float
    q1: float


def contacts() -> dict[str, Any]:
    return json.loads(FILE.read_text())


@for_each("part", range(10))
def test_take_offs_of_strongly_damped_contacts_are_exact(part):
    golden = contacts()
    assert len(golden["contacts"]) == CONTACTS
    for values, tau in list(zip(golden["contacts"], golden["tau"], strict=True))[part::10]:
        c = Contact(*values)
        s = Setting(c.gamma, c.omega, c.xi, True, c.restitution, c.penetration, False)
        step = one_phase(s, False, c.phi, (c.gap, c.gap1, c.q, c.q1), HORIZON, 1000)
        assert step.ending == ROOT, c
        assert abs(step.tau - tau) <= TOLERANCE, c


# --- the reference --------------------------------------------------------------------------


def damping_ratio(e: mpf) -> mpf:
    """zeta > 1 of a nonadhesive impact with restitution e (docs/model.md, section 2)."""

    def excess(zeta: mpf) -> mpf:
        s = mp.sqrt(zeta**2 - 1)
        return zeta / s * mp.log((zeta + s) / (zeta - s)) + mp.log(e)

    guess = 1 / (2 * mp.sqrt(e))
    return mp.findroot(excess, (guess, guess * mpf("1.01")), tol=mpf(10) ** -100)


class Force:
    """n and n' of a contact: the sum of weight * exp(rate tau)."""

    def __init__(self, c: Contact) -> None:
        gravity, d, omega = 1 / mpf(c.gamma), mpf(c.penetration), mpf(c.omega)
        w, b = omega**-2, 2 * mpf(c.xi) / omega
        kappa, beta = d**-2, 2 * damping_ratio(mpf(c.restitution)) / d
        # u' = M u + drive, u = (gap, gap', q, q'); see tests/support/naive.py
        matrix = mp.matrix([[0, 1, 0, 0], [-kappa, -beta, w, b], [0, 0, 0, 1], [kappa, beta, -2 * w, -2 * b]])
        still = mp.lu_solve(matrix, mp.matrix([0, gravity, 0, 0]))
        wave = mp.lu_solve(mp.eye(4) * mpc(0, 1) - matrix, mp.matrix([0, 1, 0, 0])) * mp.expj(mpf(c.phi))
        state = mp.matrix([mpf(c.gap), mpf(c.gap1), mpf(c.q), mpf(c.q1)]) - still - wave.apply(mp.re)
        polynomial = [1, beta + 2 * b, kappa + 2 * w + b * beta, b * kappa + w * beta, w * kappa]
        free = mp.polyroots(polynomial, maxsteps=5000, extraprec=600)
        derivatives = []
        for _ in free:
            derivatives.append(-kappa * state[0] - beta * state[1])
            state = matrix * state
        powers = mp.matrix([[rate**order for rate in free] for order in range(4)])
        weights = list(mp.lu_solve(powers, mp.matrix(derivatives)))
        driven = -(kappa * wave[0] + beta * wave[1])
        self.rates = [*free, mpc(0), mpc(0, 1)]
        self.weights = [*weights, mpc(-kappa * still[0]), driven]

    def __call__(self, tau: mpf) -> tuple[mpf, mpf]:
        """n and n'; 60 digits are enough once the weights are known."""
        with mp.workdps(60):
            n, slope = mpc(0), mpc(0)
            for weight, rate in zip(self.weights, self.rates, strict=True):
                part = weight * mp.exp(rate * tau)
                n, slope = n + part, slope + rate * part
            return n.real, slope.real

    def instants(self) -> np.ndarray:
        """Fifty in each decade from 1e-8 of the fastest rate's time on, then forty a radian or more."""
        begin = float(mpf("1e-8") / max(abs(rate) for rate in self.rates))
        ringing = max(abs(float(rate.imag)) for rate in self.rates)
        even = np.arange(0.0, HORIZON, 0.025 / max(1.0, ringing))
        spread = np.geomspace(begin, HORIZON, int(50 * math.log10(HORIZON / begin)))
        return np.unique(np.concatenate([[0.0], spread, even[even > begin]]))

    def sampled(self, taus: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """n and n' in double precision, but for n in many digits where the sum cancels."""
        weights, rates = (np.array([complex(x) for x in values]) for values in (self.weights, self.rates))
        with np.errstate(under="ignore"):
            parts = weights * np.exp(np.outer(taus, rates))
        n = parts.sum(axis=1).real
        for i in np.flatnonzero(np.abs(n) < 1e-10 * np.abs(parts).sum(axis=1)):
            n[i] = float(self(mpf(taus[i]))[0])
        return n, (parts * rates).sum(axis=1).real

    def first_zero(self) -> mpf | None:
        """The first zero at which n falls, before the horizon; also between instants, at a minimum."""
        taus = self.instants()
        n, slope = self.sampled(taus)
        falls = (n[:-1] > 0) & (n[1:] < 0)
        turns = (n[:-1] > 0) & (n[1:] > 0) & (slope[:-1] < 0) & (slope[1:] > 0)
        for i in np.flatnonzero(falls | turns):
            low, high = mpf(taus[i]), mpf(taus[i + 1])
            if turns[i]:
                high = mp.findroot(lambda t: self(t)[1], (low, high), solver="illinois", verify=False)
            if self(high)[0] < 0:
                return self._zero(low, high)
        return None

    def _zero(self, low: mpf, high: mpf) -> mpf:
        for _ in range(120):
            middle = (low + high) / 2
            low, high = (middle, high) if self(middle)[0] > 0 else (low, middle)
        return (low + high) / 2


def random_contact(rng: np.random.Generator) -> Contact:
    gamma, omega, xi = 10.0 ** rng.uniform([-0.3, -0.7, -2.0], [1.0, 0.7, 0.5])
    e, d = 10.0 ** rng.uniform(-8.0, [-2.0, 0.0])
    phi, w, b = rng.uniform(0.0, 2.0 * math.pi), omega**-2, 2.0 * xi / omega
    q, q1 = 0.3 * rng.normal() * min(1.0, 1.0 / w) - rng.uniform(0.0, 2.0) / gamma / w, rng.normal()
    if rng.uniform() < 0.7:
        return Contact(gamma, omega, xi, e, d, phi, 0.0, -(10.0 ** rng.uniform(-6.0, 0.5)), q, q1)
    # pressed again below the surface: n = 0 and n' > 0, so that gap'' < -gap'/creep
    creep = 2.0 * float(damping_ratio(mpf(e))) * d
    press = abs(rng.normal()) / max(1.0, creep * creep)
    gap1 = press * creep * rng.uniform()
    q = (1.0 / gamma - math.cos(phi) - b * q1 - press) / w
    return Contact(gamma, omega, xi, e, d, phi, -creep * gap1, gap1, q, q1)


def main() -> None:
    mp.dps = 120
    rng = np.random.default_rng(120)
    chosen: dict[bool, list[tuple[Contact, mpf]]] = {False: [], True: []}
    while min(map(len, chosen.values())) < CONTACTS // 2:
        contact = random_contact(rng)
        force = Force(contact)
        tau = force.first_zero()
        if tau is not None and abs(force(tau)[1]) >= LEAST_SLOPE:
            chosen[tau > LONG].append((contact, tau))
    kept = [pair for pairs in chosen.values() for pair in pairs[: CONTACTS // 2]]
    kept = [kept[i] for i in rng.permutation(CONTACTS)]
    golden = {
        "source": "tests/unit/kernel/test_takeoffs.py: sums of exponentials, 120 digits, mpmath",
        "fields": Contact._fields,
        "contacts": [[float(value) for value in contact] for contact, _ in kept],
        "tau": [float(tau) for _, tau in kept],
    }
    text = json.dumps(golden)
    FILE.write_text(text.replace('"contacts": [[', '"contacts": [\n[').replace("], [", "],\n[") + "\n")


if __name__ == "__main__":
    main()
