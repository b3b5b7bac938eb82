"""The cost and the error of the contact models, measured in cells of its own choice.

The cells are ten lines of eight values of gamma, from those of the paper's figures to extremes: a plate 20
times slower or faster than the spring, no damping, a dashpot that locks, gamma = 100. Each is computed from
rest with a contact and with the purpose's reference, an exact soft contact. Errors are those of
`worker.analysis.deviation` in the cells whose reference is periodic: aperiodic cells have no flights to
compare one by one, and count only for the share of cells with another outcome or mode.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import xarray
from matplotlib.lines import Line2D

from kernel.params import Line, Outcome
from service.pictures import ATTRACTORS, Axes, Figure
from service.views.variables import dataset, row, variables
from service.views.view import Estimate, Query, View
from worker.analysis.audit import modes_differ
from worker.analysis.deviation import deviations, percentile
from worker.analysis.model_selection import timed
from worker.spec.contact_models import Ball, Contact, Rigid, Soft, Stepped
from worker.spec.time_steps import Cells
from worker.sweep import SweepSpec

#: With rebound a landing ends in infinitely many ever smaller hops, which `micro_flight` leaves out.
WINDOWS: Final[dict[str, Any]] = {"settle": 100, "observe": 50, "keep": 1_024, "micro_flight": 1e-2}

#: (Omega, xi, lowest and highest gamma), eight values each, at equal ratios.
LINES: Final = (
    (0.5, 0.26, 1.2, 5.0),  # the paper's Fig. 2
    (0.67, 0.05, 0.8, 3.0),
    (1.0, 0.05, 0.3, 3.0),
    (1.24, 0.05, 1.5, 4.0),
    (2.0, math.sqrt(0.5), 1.7, 6.0),
    (0.05, 0.1, 1.1, 3.0),  # a slow plate
    (20.0, 1.0, 2.0, 10.0),  # a fast one
    (0.5, 0.0, 1.2, 5.0),  # no damping
    (5.0, 100.0, 1.1, 10.0),  # a locked dashpot
    (0.5, 0.26, 10.0, 100.0),
)
LOCKED: Final = 8  # index of the line with xi * Omega = 500, where the spring moves like a ball
CELLS_PER_LINE: Final = 8
#: Core-seconds for which a line is repeated; a single run is too short for the clock.
MIN_SECONDS: Final = 0.05


class Purpose(NamedTuple):
    """A use of the models: the contact that their errors are measured from."""

    exact: Soft
    title: str  # of its panel
    text: str


PURPOSES: Final = {
    "adhesive": Purpose(
        Soft(restitution=0.01, penetration=1e-3),
        "studies of this contact, adhesive: $d = 10^{-3}$, $e = 0.01$",
        "errors from exact soft contact, adhesive, d = 0.001, e = 0.01: for studies of this contact",
    ),
    "nonadhesive": Purpose(
        Soft(restitution=0.01, penetration=1e-3, adhesive=False),
        "the same, nonadhesive",
        "errors from the same contact, nonadhesive",
    ),
    "plate": Purpose(
        Soft(restitution=1e-6, penetration=1e-7, adhesive=False),
        "studies of a hard plate: $d, e \\to 0$",
        "errors from exact soft contact, nonadhesive, d = 1e-7, e = 1e-6: for studies of a hard plate",
    ),
}


class Setting(NamedTuple):
    """A contact for a purpose, on all lines or the locked one."""

    purpose: str
    contact: Contact
    locked: bool = False

    @property
    def name(self) -> str:
        """The contact with its distinctive parameters: `stepped 20 verlet, d = 0.001`."""
        fields = self.contact.model_dump()
        steps = f" {fields['steps_per_contact']} {fields['scheme']}" if "scheme" in fields else ""
        depth = f", d = {fields['penetration']:g}" if "penetration" in fields else ""
        law = "" if fields.get("adhesive", True) else ", nonadhesive"
        return f"{self.contact.kind}{steps}{depth}{law}{', locked dashpot' if self.locked else ''}"


#: Measured steps per contact: the paper's rule (Eq. 13) names 20 to 100.
STEPS: Final = {"adhesive": (20, 50, 100), "nonadhesive": (20, 50)}
SCHEMES: Final = ("verlet", "euler")
DEPTHS: Final = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def _settings(purpose: str) -> list[Setting]:
    """The contacts compared for a purpose, in the order of the table.

    For a hard plate the depth decides, not the steps; `stepped` has more rebound there: as e goes to 0 its
    steps would cost a hundred times as much.
    """
    exact = PURPOSES[purpose].exact
    contacts: list[Contact] = [exact]
    if purpose in STEPS:
        soft = exact.model_dump(exclude={"kind"})
        contacts += [Stepped(**soft, steps_per_contact=n, scheme=s) for s in SCHEMES for n in STEPS[purpose]]
    else:
        contacts = [Soft(restitution=0.0, penetration=d) for d in DEPTHS]
        contacts += [exact.model_copy(update={"penetration": d}) for d in DEPTHS]
        contacts += [Stepped(restitution=1e-6, penetration=d, scheme=s) for s in SCHEMES for d in DEPTHS[:2]]
        contacts += [Stepped(restitution=1e-2, penetration=d, adhesive=False) for d in DEPTHS[:2]]
    hard = Rigid(restitution=0.0 if purpose == "plate" else exact.restitution)
    settings = [Setting(purpose, contact) for contact in (*contacts, hard, Ball())]
    return [*settings, Setting(purpose, Ball(), locked=True)]


#: All settings, in the order of the table.
SETTINGS: Final = tuple(setting for purpose in PURPOSES for setting in _settings(purpose))

_ROWS: Final = (
    row("purpose", ("setting",), "U", "what the errors are measured from"),
    row("contact", ("setting",), "U", "contact model and its parameters"),
    row("cost", ("setting",), "<f8", "core time per cell per plate period, median over the lines", "us"),
    row("cost_most", ("setting",), "<f8", "of the most expensive line", "us"),
    row("error", ("setting",), "<f8", "deviation of flight times, median over periodic cells", "rad"),
    row("error_95", ("setting",), "<f8", "95th percentile", "rad", comment="NaN: infinite"),
    row("share", ("setting",), "<f8", "share of the cells with another outcome or mode"),
)


def measure(settings: Sequence[Setting], show: Callable[[int], None]) -> xarray.Dataset:
    """Measure settings in this process, one after another; calls `show` with the number measured."""
    rows = []
    for setting in settings:
        rows.append(_row(setting))
        show(len(rows))
    data = dict(zip((variable.name for variable in _ROWS), zip(*rows, strict=True), strict=True))
    attrs = {name: purpose.text for name, purpose in PURPOSES.items()}
    attrs["cells"] = f"{len(LINES) * CELLS_PER_LINE}, {_PERIODS} plate periods from rest"
    return dataset(variables(_ROWS, data), {}, attrs)


_PERIODS: Final = WINDOWS["settle"] + WINDOWS["observe"]


def _row(setting: Setting) -> tuple[Any, ...]:
    """The values of _ROWS, rounded to three digits: repeated measurements agree in no more."""
    lines = LINES[LOCKED : LOCKED + 1] if setting.locked else LINES
    own = [_computed(line, setting.contact) for line in lines]
    exact = [_computed(line, PURPOSES[setting.purpose].exact)[0] for line in lines]
    pairs = [(true, record) for true, (record, _) in zip(exact, own, strict=True)]
    costs = np.array([cost for _, cost in own])
    errors = np.concatenate(
        [deviations(*pair, WINDOWS["micro_flight"])[pair[0].outcome == Outcome.PERIODIC] for pair in pairs]
    )
    wrong = np.concatenate([modes_differ(*pair) for pair in pairs])
    values = (percentile(costs, 50.0), percentile(costs, 100.0),
              percentile(errors, 50.0), percentile(errors, 95.0), float(np.mean(wrong)))  # fmt: skip
    rounded = (math.nan if value is None else float(f"{value:.3g}") for value in values)
    return setting.purpose, setting.name, *rounded


@lru_cache(maxsize=64)
def _computed(line: tuple[float, float, float, float], contact: Contact) -> tuple[Line, float]:
    """The record of a line with a contact, and its core-microseconds per cell per plate period."""
    omega, xi, low, high = line
    gamma = np.geomspace(low, high, CELLS_PER_LINE)
    spec = SweepSpec(gamma=gamma.tolist(), omega=omega, xi=xi, model=contact, **WINDOWS)
    cells = Cells(gamma, np.full_like(gamma, omega), np.full_like(gamma, xi))
    [record], cost = timed(spec, [cells], MIN_SECONDS)
    return record, cost


# The picture


class Series(NamedTuple):
    """How the rows of one model or scheme are drawn."""

    label: str
    colour: str  # from the palette of Okabe and Ito, for colour-blind readers too
    marker: str
    text_at: tuple[float, float]  # place of a label, in points from its mark
    text_side: str  # side of the label that is at this place


SERIES: Final = {
    "soft": Series("soft, exact", ATTRACTORS[0], "o", (0, 7), "center"),
    "verlet": Series("stepped, Verlet (steps per contact)", ATTRACTORS[5], "s", (-6, -9), "right"),
    "euler": Series("stepped, Euler", ATTRACTORS[1], "^", (6, 3), "left"),
    "rigid": Series("rigid", "black", "D", (0, 0), "center"),
    "ball": Series("ball, $\\varepsilon = f(\\xi)$", ATTRACTORS[2], "*", (-7, -3), "right"),
}
#: Limits of the axes: rad, core-µs per cell per plate period.
ERRORS: Final = (1e-14, 1e4)
COSTS: Final = (0.02, 3e4)


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """The cost of a plate period against the error of flight times, a panel for each purpose."""
    panels = figure.subplots(1, len(PURPOSES), sharey=True)
    for axes, (name, purpose) in zip(panels, PURPOSES.items(), strict=True):
        axes.set(xscale="log", yscale="log", xlim=ERRORS, ylim=COSTS)
        axes.grid(color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_title(purpose.title, loc="left", fontsize=11)
        axes.set_xlabel("error of flight times (rad): median, and to the 95th percentile")
        axes.text(0.985, 0.975, "better: down and to the left", transform=axes.transAxes, ha="right",
                  va="top")  # fmt: skip
        lines: dict[tuple[str, bool], list[int]] = {}  # joined over the steps or the depths
        for i, setting in enumerate(SETTINGS):
            if setting.purpose == name:
                fields = setting.contact.model_dump()
                key = (fields.get("scheme", setting.contact.kind), fields.get("adhesive", True))
                lines.setdefault(key, []).append(i)
        for (series, adhesive), line in lines.items():
            _draw_line(axes, SERIES[series], adhesive, result, line)
    panels[0].set_ylabel("core-µs per cell per plate period", fontsize=11)
    handles = [
        Line2D([], [], color=series.colour, marker=series.marker, label=series.label, linewidth=1)
        for series in SERIES.values()
    ]
    handles.append(Line2D([], [], color="black", marker="o", markerfacecolor="white", linewidth=0,
                          label="hollow: nonadhesive"))  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)


def _draw_line(axes: Axes, series: Series, adhesive: bool, result: xarray.Dataset, line: list[int]) -> None:
    """Rows of one model or scheme under one law; a reference is a line across the panel."""
    cost, error, error_95 = (result[name].values for name in ("cost", "error", "error_95"))
    points = [i for i in line if error[i] > 0.0]
    for i in (i for i in line if error[i] == 0.0):
        axes.axhline(cost[i], color=series.colour, linewidth=1, linestyle="--")
        axes.annotate(f"exact soft, the reference: {cost[i]:.2g} µs", (ERRORS[1] / 1.5, cost[i]), (0, 4),
                      textcoords="offset points", fontsize=9, ha="right")  # fmt: skip
    to_95 = np.nan_to_num(error_95[points], nan=ERRORS[1]) - error[points]
    axes.errorbar(
        error[points], cost[points], xerr=[np.zeros(len(points)), to_95], color=series.colour,
        marker=series.marker, markersize=10 if series.marker == "*" else 5.5, linewidth=1, elinewidth=0.8,
        linestyle="none" if series.marker == "*" else "-",
        markerfacecolor=series.colour if adhesive else "white",
    )  # fmt: skip
    right, up = series.text_at
    up += 0 if adhesive or right > 0 else 6
    for i in points:
        axes.annotate(_label(SETTINGS[i]), (error[i], cost[i]), (right, up),
                      textcoords="offset points", fontsize=9, ha=series.text_side)  # fmt: skip


def _label(setting: Setting) -> str:
    """The label of a point: steps for studies of a contact, depths for a hard plate; some of `soft` only."""
    contact = setting.contact
    if isinstance(contact, Ball):
        return "where the dashpot locks" if setting.locked else "everywhere"
    if isinstance(contact, Stepped) and setting.purpose in STEPS:
        return str(contact.steps_per_contact)
    ends = DEPTHS[::4] if getattr(contact, "adhesive", True) else DEPTHS[-1:]
    if isinstance(contact, Stepped) or (isinstance(contact, Soft) and contact.penetration in ends):
        return f"$d = 10^{{{math.log10(contact.penetration or 1.0):.0f}}}$"
    return ""


VIEW: Final = View(
    "tradeoff", "Cost and error of the contact models", None, Query, measure,
    lambda spec, query: Estimate({}), variables=_ROWS, rows="cost", draw=draw, size=(13.2, 4.8),
)  # fmt: skip
