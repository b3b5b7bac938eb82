"""The table of docs/hysteresis.md, "Other contacts"."""

import re
from functools import cache

from paths import ROOT

from benchmarks.contacts import CONTACTS, end_of_bouncing, shift_text
from kernel.branches.thresholds import Thresholds, thresholds

TEXT = (ROOT / "docs" / "hysteresis.md").read_text()

SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL))

XI = 0.05

TABLE_OMEGAS = (0.56, 0.60, 0.62, 0.66, 0.70)

#: The measured rows of other contacts.
LONG_ROWS = re.findall(r"^\| 0\.\d\d \| 0\.000 \|.*$", SECTIONS["Other contacts"], re.MULTILINE)


@cache
def at(omega: float, xi: float = XI) -> Thresholds:
    return thresholds(omega, xi)


def test_other_contacts():
    assert len(LONG_ROWS) == len(TABLE_OMEGAS)
    for row, omega in zip(LONG_ROWS, TABLE_OMEGAS, strict=True):
        moved = [end_of_bouncing(omega, contact, 1e-4) - at(omega).down for contact in CONTACTS]
        cells = [shift_text(value, 3) for value in moved]
        assert row == f"| {omega:.2f} | {' | '.join(cells)} |"
