"""The palette: one file for page and pictures, told apart with a colour-vision deficiency too."""

import re
from itertools import combinations, pairwise

import pytest
from coloraide import Color
from paths import ROOT

from kernel.labels import LABELS
from service.pictures import PALETTE

#: The least difference of two classes, in CIEDE2000.
APART = 12.0
VISIONS = ("", "deutan", "tritan")
#: Labels of most cells beside certified ones.
UNCERTIFIED = ("at_rest", "aperiodic", "settling")


def seen(colour: str, vision: str) -> Color:
    return Color(colour).filter(vision).clip() if vision else Color(colour)


def difference(one: str, other: str) -> float:
    """The least over the visions."""
    return min(seen(one, vision).delta_e(seen(other, vision), method="2000") for vision in VISIONS)


def neighbours(scheme: int) -> set[tuple[str, str]]:
    """Pairs of classes that a map shows beside each other: cycles with as many bounces as periods and what is
    no cycle, all shades of one number of periods, and the same shade of the next number.
    """
    periods = PALETTE["periods"]
    plain = [middle for _, middle, _ in periods]
    plain += [pair[scheme] for pair in (PALETTE["longer"], *PALETTE["labels"].values())]
    pairs = {*combinations(plain, 2), *(pair for shades in periods for pair in combinations(shades, 2))}
    return pairs | {pair for shade in range(3) for pair in pairwise(shades[shade] for shades in periods)}


@pytest.mark.parametrize("scheme", [0, 1], ids=["on white", "on dark"])
def test_classes_of_a_picture_differ(scheme: int):
    """Neighbours on a map; margins of stability, and what has none; attractors; directions."""
    margins = [*PALETTE["margins"], *(PALETTE["labels"][name][scheme] for name in UNCERTIFIED)]
    attractors = [pair[scheme] for pair in PALETTE["attractors"]]
    directions = [PALETTE["lines"][name][scheme] for name in ("rest", "up", "down")]
    pairs = neighbours(scheme).union(*(combinations(each, 2) for each in (margins, attractors, directions)))
    assert min((difference(*pair), *pair) for pair in pairs)[0] >= APART


def test_every_label_but_that_of_a_cycle_has_a_colour():
    assert set(PALETTE["labels"]) == {*LABELS} - {"periodic"}


def test_no_colour_is_written_beside_the_palette():
    """The rest of the project has colours of the page's frame alone, in its style sheet."""
    files = [*(ROOT / "service").rglob("*.py"), *(ROOT / "service/static/js").rglob("*.js")]
    written = {
        file.name: found for file in files if (found := re.findall(r'"#[0-9a-f]{6}"', file.read_text()))
    }
    assert written == {"pictures.py": ['"#a6a6a6"']}
