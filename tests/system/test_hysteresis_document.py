"""Every number of docs/hysteresis.md, computed again.

Each section lists the texts that it must contain, formatted from computed values, and every decimal number of
the section must be in one of them or be a parameter.
"""

import math
import re
from collections import Counter
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import hysteresis
import numpy as np
import pytest
from kernel_runs import run
from paths import ROOT
from PIL import Image
from tips import end_of_hysteresis, soft_landing, tip

from kernel import creep
from kernel.cycles.curves import Parameter, curves
from kernel.cycles.events import Kind, branch_and_events, fold_events
from kernel.cycles.folds import lifetime
from kernel.cycles.starts import start_on_stable_cycle
from kernel.cycles.thresholds import SEARCHED_XI, Thresholds, conjecture, thresholds
from kernel.models import rigid
from kernel.params import Cell, Outcome
from kernel.proofs.balls import bounds
from kernel.proofs.branches import prove_down
from kernel.search import random_starts, search
from kernel.threshold import threshold
from service.presets import FIGURES
from worker.analysis.prediction import of_contact
from worker.spec.contact_models import Rigid, Soft

PLATE = rigid.plate(restitution=np.zeros(1))
TEXT = (ROOT / "docs" / "hysteresis.md").read_text()
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL))
XI = 0.05
TABLE_OMEGAS = (0.56, 0.60, 0.62, 0.66, 0.70)

#: What the text chooses rather than computes: dampings and frequencies.
CHOSEN = {"0.01", "0.02", "0.05", "0.1", "0.2", "0.46", "0.26", "0.82", "1.24", "1.26", "1.28", "0.5"}
CHOSEN |= {"0.001", "0.3", "0.6"}
CHOSEN |= {f"{omega:.2f}" for omega in TABLE_OMEGAS}

#: The contacts of the columns of "Other contacts".
CONTACTS = (*(Soft(penetration=depth) for depth in (0.001, 0.1)), *(Rigid(restitution=e) for e in (0.3, 0.5)))

#: The measured rows of searches.
SEARCHED_ROWS = re.findall(r"^\| 0\.\d+ to .*$", SECTIONS["How far the rule was searched"], re.MULTILINE)

#: The scripts that draw the document's figures, and arguments with which they take a second.
SMALL: dict[str, dict[str, Any]] = {
    "branches": {"num": 22},
    "other_contacts": {"num": 2, "frequencies": (0.6,)},
    "curves": {"lines": 5, "tips": 1},
    "energy": {"num": 11},
    "hysteresis": {
        "num": 13,
        "omegas": (0.33, 0.44, 0.6, 0.62, 0.7),
        "loop": {
            **FIGURES[8].sweeps[0],
            "omega": [0.44, 0.6],
            "gamma": {"start": 0.1, "stop": 1.6, "num": 76},
        },
    },
}

Texts = list[str]


@cache
def at(omega: float, xi: float = XI) -> Thresholds:
    return conjecture(omega, xi) if xi < SEARCHED_XI else thresholds(omega, xi)


def three_thresholds() -> Texts:
    rows = [f"| {w:.2f} | {at(w).gamma_th:.9f} | {at(w).jump:.9f} | {at(w).down:.9f} |" for w in TABLE_OMEGAS]
    found = at(0.60)
    return [
        *rows,
        f"survives down to {100 * at(0.62).down / at(0.62).gamma_th:.1f} % of the Γ",
        f"{found.cause} {round(found.gamma_th, 6)} {round(found.jump, 6)} {round(found.down, 6)}",
        "found = thresholds(0.60, 0.05)",
    ]


def where_bouncing_ends() -> Texts:
    omegas = np.round(np.linspace(0.26, 0.82, 57), 4)
    rows = []
    for xi in (0.02, 0.05, 0.1, 0.2):
        causes = Counter(at(float(omega), xi).cause for omega in omegas)
        known = [causes[name] for name in ("fold (1,1)", "Eq. 25", "unresolved")]
        words = sum(n for cause, n in causes.items() if cause.startswith("fold of word"))
        rows.append(f"| {xi:g} | {known[0]} | {words} | {known[1]} | {known[2]} |")
        assert causes.total() == sum(known) + words
    for omega in ("0.56", "0.60", "0.62", "0.66", "0.70"):
        fold = at(float(omega)).fold
        assert fold is not None
        low, high = bounds(prove_down(float(omega), XI, fold).gamma)
        rows.append(f"| {omega} | {low} | {high} |")
    assert at(1.24).cause == "fold (1,2)"
    assert at(1.26).cause == "fold of word zs (2,2)"
    picture = Image.open(ROOT / "docs" / "figures" / "figure-hysteresis.png")
    (ended, ramps) = re.findall(r"(\d+) of (\d+) ramps from the cycle end", picture.text["Description"])[0]
    assert ended == ramps == str(sum(hysteresis.seeded(omega) is not None for omega in hysteresis.OMEGAS))
    return [
        *rows,
        f"within 2·10⁻⁵ of the fold at all {ramps} frequencies",
        f"At ξ below {SEARCHED_XI:g} the threshold is",
        f"in steps of 10{'⁻⁵' if hysteresis.STEP == 1e-5 else ''} ends",
        f"Γ = {at(1.24).down:.9f}, while Γ_th = {at(1.24).gamma_th:.9f}",
        f"Its fold, Γ = {at(1.26).down:.10f}, is the end of bouncing",
        f"On {len(omegas)} frequencies from {omegas[0]:g} to {omegas[-1]:g}",
    ]


def searched() -> Texts:
    """The cycles that the rule misses; `tests/nightly/kernel/test_threshold_search.py` has random springs."""
    rows = []
    for omega, xi, effort in ((0.52, 0.02, 0), (0.4664, 0.02, 50), (0.5395, 0.032, 0)):  # as much as it takes
        rule, found = at(omega, xi), search(PLATE, omega, xi, effort=effort)
        says = f"{rule.cause} | {rule.down:.6f} |".replace(" nan", "")
        rows.append(f"| {omega:g} | {xi:g} | {says} {found.what}, {found.gamma:.6f} |")
        assert thresholds(omega, xi).cause == "not searched"
    grids = "on 400 frequencies from 0.15 to 1.4 at ξ = 0.035, 0.04 and 0.05"
    return [*rows, *SEARCHED_ROWS, grids, f"the service answers from ξ = {SEARCHED_XI:g} on"]


def share(omega: float) -> float:
    fold = at(omega).fold
    assert fold is not None
    balance = fold.energy
    return float((balance.impact / (balance.impact + balance.dashpot))[0])


def energy_row(omega: float) -> str:
    fold = at(omega).fold
    assert fold is not None
    balance = fold.energy
    given, at_impact, dashpot, impact = (
        float(part[0])
        for part in (balance.plate_contact, balance.plate_impact, balance.dashpot, balance.impact)
    )
    assert given + at_impact == pytest.approx(dashpot + impact, abs=1e-9)
    cells = [f"{value:.4f}".replace("-", "−") for value in (given, at_impact, dashpot, impact)]
    return f"| {omega:.2f} | {' | '.join(cells)} | {100 * share(omega):.1f} % |"


def soft_landings() -> Texts:
    rows = []
    for j in (1, 2, 3, 4):
        lowest, end = tip(j, 1, XI), end_of_hysteresis(j, 1)
        assert at(lowest.omega).down == pytest.approx(lowest.gamma, abs=1e-9)  # it is admissible and stable
        cells = (soft_landing(j, 1)[0], lowest.omega, lowest.gamma, end.xi)
        rows.append(f"| j = {j} | {' | '.join(f'{value:.6f}' for value in cells)} |")
    assert soft_landing(1, 2)[0] == pytest.approx(2.0 * soft_landing(1, 1)[0], rel=1e-12)
    # Γ/ξ is linear in ξ near zero
    near, far = (tip(1, 1, xi).gamma / xi for xi in (1e-5, 1e-4))
    return [
        *rows,
        *map(energy_row, TABLE_OMEGAS),
        f"Ω_12 = {soft_landing(1, 2)[0]:.6f}",
        f"Γ/ξ goes to {near + (near - far) / 9:.3f} at Ω_11",
        f"At Ω = 1.24 it is {100 * share(1.24):.2f} %",
    ]


def hysteresis_ends() -> Texts:
    found = curves(Parameter.OMEGA, XI, 0.7, 0.9, 1, (Kind.FOLD,), lines=5).points
    (cusp,) = np.flatnonzero(found.kind == Kind.CUSP)
    low, high = 0.70, 0.72
    for _ in range(40):  # where the lower fold reaches Gamma_th
        middle = 0.5 * (low + high)
        below = fold_events(middle, XI, 1, 5.0).gamma.min() < threshold(middle, XI)
        low, high = (middle, high) if below else (low, middle)
    end = end_of_hysteresis(1, 1)
    assert all(end_of_hysteresis(j, 1).xi < end.xi for j in (2, 3, 4))
    return [
        f"cusp at Ω = {found.omega[cusp]:.6f}, Γ = {found.gamma[cusp]:.6f}",
        f"Between Ω = {low:.6f} and the cusp",
        f"none is left above ξ = {end.xi:.6f}, where Ω = {end.omega:.6f}",
    ]


def periods_below(fold_gamma: float, delta: float) -> int:
    """Flights, one per plate period, of a spring lowered from its cycle at Gamma = 0.60."""
    start = start_on_stable_cycle(Cell(0.60, 0.60, XI), 1)
    assert start is not None
    gamma = fold_gamma - delta
    line = run(gamma, 0.60, XI, carry=True, start=start.start, settle=0, observe=6000, keep=1)
    return int(line.flights[0])


def ghost() -> Texts:
    fold = at(0.60).fold
    assert fold is not None
    rows = []
    for power, text in ((4, "⁻⁴"), (5, "⁻⁵"), (6, "⁻⁶")):
        predicted, simulated = lifetime(fold, 10.0**-power), periods_below(fold.gamma, 10.0**-power)
        assert simulated < predicted
        rows.append(f"| 10{text} | {predicted:.0f} | {simulated} |")
    missed = 2.0 * fold.curvature * (math.pi / (fold.slope * 120)) ** 2
    return [
        *rows,
        f"Γ'' = {fold.curvature:.4f} and λ' = {fold.slope:.4f}".replace("-", "−"),
        f"120 plate periods per step, as in a quick ramp, {1e4 * missed:.1f}·10⁻⁴ at Ω = 0.60",
    ]


def tori() -> Texts:
    found = curves(Parameter.OMEGA, XI, 0.3, 0.5, 1, (Kind.FOLD,), lines=9).points
    keep = found.kind == Kind.BOGDANOV_TAKENS
    omegas = found.omega[keep]
    assert len(omegas) == 4
    for low, high in (omegas[:2], omegas[2:]):
        assert at(float(0.5 * (low + high))).cause == "unresolved"
    rows = [f"| {omega:.6f} | {gamma:.6f} |" for omega, gamma in zip(omegas, found.gamma[keep], strict=True)]
    gaps = [f"{low:.6f} to {high:.6f}" for low, high in (omegas[:2], omegas[2:])]
    _, events = branch_and_events(0.46, XI, 1)
    fold = events.gamma[events.kind == Kind.FOLD].min()
    cell = Cell(0.85, 0.46, XI)
    states = random_starts(np.random.default_rng(1), cell.gamma, cell.omega, 100)
    line = creep.run(PLATE, np.full(100, cell.gamma), cell.omega, XI, states, 3_000, 100)
    turn = creep.rotation(PLATE, cell, line.end_state[line.outcome != Outcome.AT_REST][0])
    assert turn is not None
    end = search(PLATE, 0.46, XI, effort=0)
    assert end.rotation == pytest.approx(2.0 / 33.0)
    return [
        *rows, *gaps, f"by {turn.number:.6f} of a turn in each round at Γ = 0.85, and by 2/33",
        f"where it ends, Γ = {end.gamma:.4f}, far above the fold at {fold:.6f}",
    ]  # fmt: skip


def other_contacts() -> Texts:
    downs = [[of_contact(contact, omega, XI).down for contact in CONTACTS] for omega in TABLE_OMEGAS]
    assert downs[-1][-2:] == pytest.approx([at(0.70).gamma_th] * 2, abs=1e-12)
    return [
        f"| {omega:.2f} | {' | '.join(f'{down:.6f}' for down in row)} |"
        for omega, row in zip(TABLE_OMEGAS, downs, strict=True)
    ]


def not_known() -> Texts:
    assert at(1.28).cause == "unresolved"
    assert "neimark-sacker" in at(1.28).reason
    return []


CHECKED: dict[str, Callable[[], Texts]] = {
    "Three thresholds": three_thresholds,
    "A cycle in closed form": list,
    "Where bouncing ends": where_bouncing_ends,
    "How far the rule was searched": searched,
    "The minima are soft landings": soft_landings,
    "Where hysteresis ends": hysteresis_ends,
    "The ghost of the fold": ghost,
    "Tori": tori,
    "Other contacts": other_contacts,
    "What is not known": not_known,
}


def decimals(text: str) -> set[str]:
    """The numbers with a decimal point in a text."""
    return set(re.findall(r"(?<![\w.])\d+\.\d+(?![\w.]*\.(?:md|png|py))", text))


def test_every_section_is_checked():
    assert list(SECTIONS) == list(CHECKED)
    introduction = TEXT.split("\n## ", maxsplit=1)[0]
    assert decimals(introduction) <= CHOSEN | {"3.4"}  # the paper's section


@pytest.mark.parametrize("title", CHECKED)
def test_numbers(title: str):
    texts = CHECKED[title]()
    body = SECTIONS[title]
    missing = [text for text in texts if text not in body]
    assert not missing
    assert decimals(body) - CHOSEN <= set().union(*map(decimals, texts))


@pytest.mark.parametrize("name", SMALL)
def test_the_script_of_a_figure_draws_it(name: str):
    drawn = import_module(name).draw(**SMALL[name])
    figure, ends = drawn if name == "hysteresis" else (drawn, [])
    figure.draw_without_rendering()
    assert all(axes.lines or axes.collections for axes in figure.axes)
    assert len(ends) == len(SMALL[name].get("omegas", ()))
    assert np.all(np.abs(ends) <= 2e-5)  # ramps from the cycle end at the predicted folds


def test_every_figure_has_its_script():
    assert set(SMALL) == set(re.findall(r"python docs/figures/(\w+)\.py", TEXT))


def test_scaling_of_branches():
    """(1, k) at k Omega has its events at k times the flight times of (1, 1) at Omega."""
    times: list[Any] = []
    for k in (1, 2):
        _, events = branch_and_events(0.6 * k, XI, k)
        keep = np.isin(events.kind, [Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER])
        times.append(np.sort(events.flight_time[keep]) / k)
    assert times[0] == pytest.approx(times[1], rel=1e-9)
