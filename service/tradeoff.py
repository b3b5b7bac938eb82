"""Cost and accuracy of the contact models: measured over a fixed set of cells, as a table and as a picture.

The cells are ten lines of eight values of gamma, from those of the paper's figures to extremes: a plate 20
times slower or faster than the spring, no damping, a dashpot that locks, gamma = 100. Each is computed from
rest with a model and with the purpose's reference, an exact soft contact. Errors are those of
worker.analysis.deviation in the cells whose reference is periodic. Aperiodic cells have no flights to compare
one by one and count only for the agreement of modes.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal, NamedTuple, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from kernel.line import run_line
from kernel.params import Line, Outcome
from kernel.step_limits import Scheme, stable_steps_per_contact
from service.formats import PictureFormat
from service.pictures import ATTRACTORS
from service.software import software
from service.views.style import FONT, TEXT, encode
from worker.analysis.deviation import deviations, percentile
from worker.spec.contact_models import CONTACT_MODELS
from worker.work import plate_of

SETTLE: Final = 100
OBSERVE: Final = 50
KEEP: Final = 1_024

#: Shorter flights are ignored, rad: with rebound a landing ends in infinitely many ever smaller hops.
MICRO_FLIGHT: Final = 1e-2

#: Timings are repeated for this many core-seconds: single runs are too short for the clock.
MIN_SECONDS: Final = 0.05

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

#: Gamma, Omega and xi of cells, (n,) each.
Cells = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, kw_only=True)
class Setup:
    """One model and its settings; a `restitution` of None is f(xi)."""

    purpose: str  # one of PURPOSES
    model: str
    restitution: float | None
    penetration: float | None = None
    adhesive: bool | None = None  # None for models without a law of contact
    steps_per_contact: int | None = None
    scheme: str | None = None
    locked_only: bool = False  # computed on the line with the locked dashpot alone


@dataclass(frozen=True, kw_only=True)
class Measurement(Setup):
    """Cost of a model in core-microseconds per cell per plate period, and its errors in rad."""

    cost: float | None  # median over the lines; None where its steps are refused on all
    cost_most: float | None  # of the most expensive line
    error: float | None  # median over the cells whose reference is periodic; None without one, or if infinite
    error_95: float | None  # 95th percentile
    agree: float  # share of all cells with the reference's outcome and mode


class Purpose(NamedTuple):
    """What a model is used for: the contact that its errors are measured from."""

    reference: Setup
    text: str
    title: str  # of its panel


def _soft(purpose: str, e: float, d: float, *, adhesive: bool) -> Setup:
    return Setup(purpose=purpose, model="soft", restitution=e, penetration=d, adhesive=adhesive)


PURPOSES: Final = {
    "adhesive": Purpose(  # this contact itself, which may pull
        _soft("adhesive", 0.01, 1e-3, adhesive=True),
        "exact soft contact, adhesive, d = 1e-3, e = 0.01: for studies of this contact",
        "studies of this contact, adhesive: $d = 10^{-3}$, $e = 0.01$",
    ),
    "nonadhesive": Purpose(  # the same under the law that never pulls
        _soft("nonadhesive", 0.01, 1e-3, adhesive=False),
        "exact soft contact, nonadhesive, d = 1e-3, e = 0.01: for studies of this contact",
        "the same, nonadhesive",
    ),
    "plate": Purpose(  # a hard plate without rebound
        _soft("plate", 1e-6, 1e-7, adhesive=False),
        "exact soft contact, nonadhesive, d = 1e-7, e = 1e-6: for studies of a hard plate",
        "studies of a hard plate: $d, e \\to 0$",
    ),
}

#: Measured steps per contact: the paper's rule (Eq. 13) names 20 to 100.
STEPS: Final = (20, 50, 100)
SCHEMES: Final = ("verlet", "euler")
DEPTHS: Final = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def _stepped(
    purpose: str, e: float, d: float, steps: Sequence[int], schemes: Sequence[str], *, adhesive: bool
) -> list[Setup]:
    soft = _soft(purpose, e, d, adhesive=adhesive)
    return [
        replace(soft, model="stepped", steps_per_contact=n, scheme=scheme)
        for scheme in schemes
        for n in steps
    ]


def _hard(purpose: str, e: float) -> list[Setup]:
    """The models whose plate is hard."""
    ball = Setup(purpose=purpose, model="ball", restitution=None)
    return [Setup(purpose=purpose, model="rigid", restitution=e), ball, replace(ball, locked_only=True)]


#: All setups, in the order of the table. `stepped` has fewer settings under the nonadhesive law, and more
#: rebound for a hard plate: that contact is six times shorter than an adhesive one at e = 0.01, and as e goes
#: to 0 its steps would cost a hundred times as much.
SETUPS: Final = (
    PURPOSES["adhesive"].reference,
    *_stepped("adhesive", 0.01, 1e-3, STEPS, SCHEMES, adhesive=True),
    *_hard("adhesive", 0.01),
    PURPOSES["nonadhesive"].reference,
    *_stepped("nonadhesive", 0.01, 1e-3, STEPS[:2], SCHEMES, adhesive=False),
    *_hard("nonadhesive", 0.01),
    *(_soft("plate", 0.0, d, adhesive=True) for d in DEPTHS),
    *(_soft("plate", 1e-6, d, adhesive=False) for d in DEPTHS),
    *_stepped("plate", 1e-6, 1e-2, STEPS, SCHEMES, adhesive=True),
    *_stepped("plate", 1e-6, 1e-3, STEPS, SCHEMES, adhesive=True),
    *_stepped("plate", 1e-2, 1e-2, STEPS, SCHEMES[:1], adhesive=False),
    *_stepped("plate", 1e-2, 1e-3, STEPS[:1], SCHEMES[:1], adhesive=False),
    *_hard("plate", 0.0),
)


# Measuring


def measure(setup: Setup) -> Measurement:
    """Measure a setup against its reference over all lines, or over the locked one."""
    errors, costs, agree = [np.empty(0)], [], 0
    lines = [LINES[LOCKED]] if setup.locked_only else LINES
    for cells in map(cells_of, lines):
        if not is_stable(setup, cells):
            continue
        exact = _run(PURPOSES[setup.purpose].reference, cells)
        line, cost = _timed(setup, cells)
        costs.append(cost)
        errors.append(deviations(exact, line, MICRO_FLIGHT)[exact.outcome == Outcome.PERIODIC])
        same = [getattr(exact, name) == getattr(line, name) for name in ("outcome", "bounces", "periods")]
        agree += int(np.count_nonzero(np.all(same, axis=0)))
    compared = np.concatenate(errors)
    return Measurement(
        **asdict(setup),
        cost=percentile(np.array(costs), 50.0),
        cost_most=percentile(np.array(costs), 100.0),
        error=percentile(compared, 50.0),
        error_95=percentile(compared, 95.0),
        agree=agree / (len(lines) * CELLS_PER_LINE),
    )


def cells_of(line: tuple[float, float, float, float]) -> Cells:
    """The cells of one of LINES."""
    omega, xi, low, high = line
    gamma = np.geomspace(low, high, CELLS_PER_LINE)
    return gamma, np.full_like(gamma, omega), np.full_like(gamma, xi)


def is_stable(setup: Setup, cells: Cells) -> bool:
    """Whether a specification with these steps would be accepted."""
    if setup.steps_per_contact is None or setup.scheme is None:
        return True
    fewest = stable_steps_per_contact(
        *cells[1:], setup.restitution or 0.0, setup.penetration or 0.0,
        adhesive=setup.adhesive is not False, scheme=Scheme[setup.scheme.upper()],
    )  # fmt: skip
    return bool(np.all(setup.steps_per_contact >= fewest))


def _timed(setup: Setup, cells: Cells) -> tuple[Line, float]:
    """The record, and core-microseconds per cell per plate period.

    The time is the minimum of several runs, which is the least affected by other processes.
    """
    gamma, omega, xi = cells
    _run(setup, (gamma[:1], omega[:1], xi[:1]), settle=0, observe=1)  # compiles
    shortest, total = math.inf, 0.0
    while total < MIN_SECONDS:
        began = time.thread_time()
        line = _run(setup, cells)
        took = time.thread_time() - began
        shortest, total = min(shortest, took), total + took
    return line, shortest / CELLS_PER_LINE / (SETTLE + OBSERVE) * 1e6


def _run(setup: Setup, cells: Cells, settle: int = SETTLE, observe: int = OBSERVE) -> Line:
    fields = CONTACT_MODELS[setup.model].fields
    values = {name: x for name, x in asdict(setup).items() if name in fields.model_fields and x is not None}
    contact: Any = fields(**{**values, "kind": setup.model})
    return run_line(
        *cells, plate=plate_of(contact, *cells), carry=False,
        settle=settle, observe=observe, keep=KEEP, micro_flight=MICRO_FLIGHT,
    )  # fmt: skip


# The table


def report(rows: Sequence[Measurement]) -> str:
    """The table, one part per purpose, and its legend."""
    names = ("", "µs", "max µs", "error", "95%", "mode")
    heading = "".join(f"{name:>{10 if i else 36}}" for i, name in enumerate(names))
    lines = []
    for name, purpose in PURPOSES.items():
        table = [_line_of_table(row) for row in rows if row.purpose == name]
        lines += [f"Errors relative to the {purpose.text}", heading, *table, ""]
    legend = (
        "µs: core-µs per cell per plate period, median over lines of cells; max µs: the most expensive line.",
        "error: of flight times in rad, median and 95th percentile over cells whose reference is periodic.",
        f"mode: share of all {len(LINES) * CELLS_PER_LINE} cells with the outcome and mode of the reference; "
        f"{SETTLE + OBSERVE} periods from rest, flights over {MICRO_FLIGHT:g} rad.",
    )
    return "\n".join([*lines, *legend])


def _line_of_table(row: Measurement) -> str:
    costs = ["refused" if cost is None else f"{cost:.3g}" for cost in (row.cost, row.cost_most)]
    errors = [
        "-" if error is None else "exact" if error == 0.0 and row.model == "soft" else f"{error:.1e}"
        for error in (row.error, row.error_95)
    ]
    return f"{_setting(row):>36}{''.join(f'{each:>10}' for each in costs + errors)}{row.agree:10.0%}"


def _setting(row: Measurement) -> str:
    """A model and its parameters: `stepped 20 verlet, d = 0.001`, with the law where it is nonadhesive."""
    parts = [f"stepped {row.steps_per_contact} {row.scheme}" if row.scheme else row.model]
    if row.penetration:
        parts.append(f"d = {row.penetration:g}")
    if row.adhesive is False:
        parts.append("nonadhesive")
    if row.model == "ball":
        parts += ["e = f(xi)", *(["locked dashpot"] if row.locked_only else [])]
    return ", ".join(parts)


# The picture


class Series(NamedTuple):
    """How the rows of one model or scheme are drawn."""

    label: str
    colour: str  # one of those that colour-blind readers can tell apart (Okabe and Ito's)
    marker: str
    text_at: tuple[float, float]  # where labels are, in points of text from theirs
    text_side: Literal["left", "center", "right"]  # of the label, at that place


SERIES: Final = {
    "soft": Series("soft, exact", ATTRACTORS[0], "o", (0, 7), "center"),
    "verlet": Series("stepped, Verlet", ATTRACTORS[5], "s", (-6, -3), "right"),
    "euler": Series("stepped, Euler\n(numbers: steps per contact)", ATTRACTORS[1], "^", (5, 2), "left"),
    "rigid": Series("rigid", "black", "D", (0, 0), "center"),
    "ball": Series(
        "ball, $\\varepsilon = f(\\xi)$\n(hollow markers: nonadhesive)", ATTRACTORS[2], "*", (0, 6), "center"
    ),
}
SIZE: Final = (13.2, 4.4)  # inches
#: Limits of the axes: rad, core-µs per cell per plate period.
ERRORS: Final = (1e-14, 100.0)
COSTS: Final = (0.02, 1e4)


def draw(rows: Sequence[Measurement], format: str) -> bytes:
    """The bytes of the work-precision diagram: cost of a plate period against the error of flight times."""
    origin = {"release": software().release}
    return encode(SIZE, lambda figure: compose(figure, rows), cast(PictureFormat, format), origin)


def compose(figure: Figure, rows: Sequence[Measurement]) -> None:
    """Draw a panel for each purpose, hollow markers for the nonadhesive law, on a figure of SIZE."""
    panels = figure.subplots(1, len(PURPOSES), sharey=True)
    for axes, (name, purpose) in zip(panels, PURPOSES.items(), strict=True):
        axes.set(xscale="log", yscale="log", xlim=ERRORS, ylim=COSTS)
        axes.grid(color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.tick_params(which="both", direction="in", top=True, right=True, labelfontfamily=FONT)
        axes.set_title(purpose.title, loc="left", fontsize=11, **TEXT)
        axes.set_xlabel("error of flight times (rad): median, and to the 95th percentile", **TEXT)
        axes.text(0.985, 0.975, "better: down and to the left", transform=axes.transAxes, ha="right",
                  va="top", **TEXT)  # fmt: skip
        lines: dict[tuple[object, ...], list[Measurement]] = {}  # joined over the steps or the depths
        for row in rows:
            if row.purpose == name and row.error is not None and row.cost is not None:
                depth = row.penetration if row.scheme else None
                lines.setdefault((row.scheme or row.model, row.adhesive, depth), []).append(row)
        for (series, *_), line in lines.items():
            _draw_line(axes, SERIES[str(series)], line)
    panels[0].set_ylabel("core-µs per cell per plate period", fontsize=11, **TEXT)
    handles = [
        Line2D([], [], color=series.colour, marker=series.marker, label=series.label, linewidth=1)
        for series in SERIES.values()
    ]
    font = FontProperties(family=FONT, size=9, math_fontfamily="stix")
    panels[0].legend(handles=handles, loc="lower left", prop=font)


def _draw_line(axes: Axes, series: Series, rows: list[Measurement]) -> None:
    """Rows of one model or scheme under one law; a reference is a line across the panel."""
    for cost in (row.cost or 0.0 for row in rows if row.error == 0.0):
        axes.axhline(cost, color=series.colour, linewidth=1, linestyle="--")
        axes.annotate(f"exact soft, the reference: {cost:.2g} µs", (ERRORS[1] / 1.5, cost), (0, 4),
                      textcoords="offset points", fontsize=9, ha="right", **TEXT)  # fmt: skip
    points = [row for row in rows if row.error]
    errors, costs = np.array([(row.error, row.cost) for row in points], float).reshape(-1, 2).T
    to_95 = np.array([row.error_95 or ERRORS[1] for row in points]) - errors
    axes.errorbar(
        errors, costs, xerr=[np.zeros(len(points)), to_95], color=series.colour, marker=series.marker,
        markersize=10 if series.marker == "*" else 5.5, linestyle="none" if rows[0].model == "ball" else "-",
        markerfacecolor="white" if rows[0].adhesive is False else series.colour, linewidth=1, elinewidth=0.8,
    )  # fmt: skip
    below = rows[0].model == "soft" and rows[0].adhesive is False
    for row in points:
        axes.annotate(_label(row), (row.error, row.cost), (0, -14) if below else series.text_at,
                      textcoords="offset points", fontsize=9, ha=series.text_side, **TEXT)  # fmt: skip


def _label(row: Measurement) -> str:
    """The label of a point; of the depths of a soft contact only the ends have one."""
    if row.model == "ball":
        return "where the dashpot locks" if row.locked_only else "everywhere"
    depth = f"$d = 10^{{{math.log10(row.penetration or 1.0):.0f}}}$"
    if row.scheme is None:
        return depth if row.penetration in (DEPTHS[0], DEPTHS[-1]) else ""
    with_depth = row.scheme == "verlet" and row.steps_per_contact == STEPS[0]
    return f"{depth}, {row.steps_per_contact}" if with_depth else str(row.steps_per_contact)
