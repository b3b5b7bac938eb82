"""Take-offs from strongly damped contacts against 120-digit arithmetic (tests/golden/takeoffs.json).

Nonadhesive, zeta from 5 to 5,000: the mass stops within d/(2 zeta) rad, then creeps back at 1/(2 zeta d).
The reference sums the exponentials of the motion, whose rates are the roots of its characteristic
polynomial, and looks for the first zero of n on a grid that is fine beside every rate.
"""

import json
import math
from typing import Any, NamedTuple

from kernel_runs import one_phase
from naive import Setting
from paths import GOLDEN
from tables import for_each

from kernel.numerics.first_root import ROOT

FILE = GOLDEN / "takeoffs.json"

CONTACTS = 1000
HORIZON = 4.0 * math.pi

#: rad. The error of the kernel's n, a few 1e-16 of its terms, over the least slope below.
TOLERANCE = 1e-11


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
