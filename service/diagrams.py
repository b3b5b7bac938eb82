"""A diagram as JSON, as a table, or as a picture fit for a paper."""

import csv
import io
import json
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import AutoMinorLocator, MaxNLocator
from numpy.typing import NDArray

from kernel.params import Outcome
from kernel.threshold import threshold
from service.queries import Diagram, Plane
from worker.spec import SweepSpec

#: The columns of the table, with units where there are any. One row is one flight.
COLUMNS: Final = (
    "direction",
    "gamma",
    "omega",
    "xi",
    "flight",
    "flight_time_rad",
    "takeoff_phase_rad",
    "outcome",
    "bounces",
    "periods",
)

SYMBOLS: Final = {"gamma": r"$\Gamma$", "omega": r"$\Omega$", "xi": r"$\xi$"}

#: Colour and relative size of the points: of one direction; of up below down, a rim where the two agree.
#: The colours survive colour blindness and a photocopier.
ALONE: Final = (("black", 1.0),)
OVERLAID: Final = (("#a6a6a6", 1.7), ("#b2182b", 0.8))

FONT: Final = "STIXGeneral"
TEXT: Final[dict[str, Any]] = {"fontfamily": FONT, "math_fontfamily": "stix"}
TURN: Final = 2 * np.pi

#: More points than this become an image inside an SVG.
MANY_POINTS: Final = 5_000

#: matplotlib shares caches between figures without locking them.
drawing: Final = threading.Lock()


def as_json(diagram: Diagram) -> bytes:
    """The diagram as a JSON document; every list of flights is as long as there are flights to show."""
    members = {
        "along": _json(diagram.along),
        "fixed": _json(diagram.fixed),
        "direction": _json(diagram.direction),
        "values": _json(diagram.values.tolist()),
        "flight_time": _lists(diagram.flight_time, diagram.shown),
        "takeoff_phase": _lists(diagram.takeoff_phase, diagram.shown),
        "flights": _json(diagram.flights.tolist()),
        "outcome": _json(diagram.outcome.tolist()),
        "bounces": _json(diagram.bounces.tolist()),
        "periods": _json(diagram.periods.tolist()),
        "complete": _json(diagram.complete),
    }
    return _object(members)


def modes_as_json(plane: Plane) -> bytes:
    """A mode map as a JSON document; arrays as lists of rows, one for each Ω."""
    members = {
        "xi": _json(plane.xi),
        "direction": _json(plane.direction),
        "omega": _json(plane.omega.tolist()),
        "gamma": _json(plane.gamma.tolist()),
        **{name: _rows_of(array) for name, array in plane.arrays.items()},
        "complete": _json(plane.complete),
    }
    return _object(members)


def as_csv(diagrams: Sequence[Diagram]) -> bytes:
    """A table with a header and one row a flight; cells without flights have none."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for diagram in diagrams:
        table.writerows(_rows(diagram))
    return text.getvalue().encode()


def as_picture(diagrams: Sequence[Diagram], spec: SweepSpec, format: str) -> bytes:
    """A PNG or SVG of flight times along the axis, the directions over each other.

    A cell at rest has no flight and so no point. Missing cells are told on the picture.
    """
    with drawing:
        figure = Figure(figsize=(6.8, 4.2), dpi=200, layout="constrained")
        _draw(figure.subplots(), diagrams, spec)
        file = io.BytesIO()
        figure.savefig(file, format=format, metadata={"Date": None} if format == "svg" else {})
    return file.getvalue()


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def _object(members: Mapping[str, str]) -> bytes:
    return ("{" + ",".join(f'"{name}":{text}' for name, text in members.items()) + "}").encode()


def _rows_of(array: NDArray[Any]) -> str:
    """Row by row, so that other threads get their turn in between."""
    return "[" + ",".join(_json(row.tolist()) for row in array) + "]"


def _lists(values: NDArray[np.float64], shown: NDArray[np.bool_]) -> str:
    """A list for every cell; written one by one, so that other threads get their turn in between."""
    return "[" + ",".join(_json(row[mask].tolist()) for row, mask in zip(values, shown, strict=True)) + "]"


def _rows(diagram: Diagram) -> Iterator[list[Any]]:
    outcomes = {int(outcome): outcome.name.lower() for outcome in Outcome}
    for cell, value in enumerate(diagram.values.tolist()):
        point = {**diagram.fixed, diagram.along: value}
        place = [diagram.direction, point["gamma"], point["omega"], point["xi"]]
        what = [outcomes[int(diagram.outcome[cell])], int(diagram.bounces[cell]), int(diagram.periods[cell])]
        times, phases = diagram.flight_time[cell].tolist(), diagram.takeoff_phase[cell].tolist()
        for flight in np.flatnonzero(diagram.shown[cell]).tolist():
            yield [*place, flight, times[flight], phases[flight], *what]


def _draw(axes: Axes, diagrams: Sequence[Diagram], spec: SweepSpec) -> None:
    first = diagrams[0]
    for diagram, (colour, size) in zip(diagrams, ALONE if len(diagrams) == 1 else OVERLAID, strict=True):
        _draw_points(axes, diagram, colour, size)
    _scale(axes, first.values, max(_highest(diagram) for diagram in diagrams))
    _draw_turns(axes)
    if first.along == "gamma":
        _draw_threshold(axes, first)
    _describe(axes, first, spec)
    if len(diagrams) > 1:
        _legend(axes)
    _warn(axes, sum(diagram.missing for diagram in diagrams), sum(len(one.values) for one in diagrams))


def _draw_points(axes: Axes, diagram: Diagram, colour: str, scale: float = 1.0) -> None:
    cells, flights = np.nonzero(diagram.shown)
    size = float(np.clip(450 / max(len(diagram.values), 1), 0.7, 3.5))
    axes.plot(
        diagram.values[cells],
        diagram.flight_time[cells, flights],
        linestyle="none",
        marker=".",
        markersize=2 * size * scale,  # the dot is half as wide as its marker
        markeredgewidth=0,
        color=colour,
        alpha=0.8,
        rasterized=len(cells) > MANY_POINTS,
        label=diagram.direction,
        zorder=3,
    )


def _highest(diagram: Diagram) -> float:
    """The longest flight shown, in rad; a turn if there is none."""
    return float(np.max(diagram.flight_time, where=diagram.shown, initial=0.0)) or TURN


def _scale(axes: Axes, values: NDArray[np.float64], highest: float) -> None:
    if len(values) > 1:
        axes.set_xlim(float(values[0]), float(values[-1]))
    if _is_geometric(values):
        axes.set_xscale("log")
    else:
        axes.xaxis.set_minor_locator(AutoMinorLocator())
    axes.yaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))
    axes.yaxis.set_minor_locator(AutoMinorLocator())
    axes.set_ylim(0, 1.06 * highest)


def _is_geometric(values: NDArray[np.float64]) -> bool:
    """Whether the values go in equal ratios and not in equal steps."""
    if len(values) < 3 or values[0] <= 0:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and np.ptp(steps) > 1e-6 * steps[0])


def _draw_turns(axes: Axes) -> None:
    """Whole plate periods as faint lines, counted on the right."""
    _, top = axes.get_ylim()
    turns = np.arange(1, int(top / TURN) + 1)
    step = max(1, len(turns) // 8)
    right = axes.secondary_yaxis("right")
    right.set_yticks(turns[::step] * TURN, [_turns(int(turn)) for turn in turns[::step]])
    right.tick_params(labelsize=9, length=0, labelcolor="0.45")
    for label in right.get_yticklabels():
        label.set_math_fontfamily("stix")
    for turn in turns[::step]:
        axes.axhline(turn * TURN, color="0.85", linewidth=0.6, zorder=1)


def _turns(turns: int) -> str:
    return rf"${2 * turns}\pi$"


def _draw_threshold(axes: Axes, diagram: Diagram) -> None:
    """Γ_th of Eq. 25, where a spring at rest begins to bounce."""
    onset = float(threshold(diagram.fixed["omega"], diagram.fixed["xi"]))
    if diagram.values[0] <= onset <= diagram.values[-1]:
        axes.axvline(onset, color="#2166ac", linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
        axes.annotate(
            r"$\Gamma_{\mathrm{th}}$",
            (onset, 1),
            (3, -4),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            verticalalignment="top",
            color="#2166ac",
            fontsize=10,
            math_fontfamily="stix",
        )


def _describe(axes: Axes, diagram: Diagram, spec: SweepSpec) -> None:
    axes.set_xlabel(SYMBOLS[diagram.along], fontsize=12, **TEXT)
    axes.set_ylabel(r"flight time $\varphi$  (rad)", fontsize=12, **TEXT)
    fixed = ",   ".join(f"{SYMBOLS[axis]} = {value:.6g}" for axis, value in diagram.fixed.items())
    axes.set_title(fixed, loc="left", fontsize=11, **TEXT)
    axes.set_title(_how(diagram, spec), loc="right", fontsize=8.5, color="0.35", **TEXT)
    axes.tick_params(which="both", direction="in", top=True, labelfontfamily=FONT, labelsize=10)


def _how(diagram: Diagram, spec: SweepSpec) -> str:
    """How the cells were computed, in a few words."""
    start = "from rest" if spec.ramp_axis is None else f"ramped along {SYMBOLS[spec.ramp_axis]}"
    least = f", flights of at least {diagram.min_flight:g} rad" if diagram.min_flight else ""
    lost = int(np.count_nonzero(np.isin(diagram.outcome, (Outcome.UNRESOLVED, Outcome.DIVERGED))))
    unresolved = f", {lost:,} of {len(diagram.values):,} cells unresolved" if lost else ""
    return f"{spec.model.kind} contact, {start}{least}{unresolved}"


def _legend(axes: Axes) -> None:
    legend = axes.legend(
        loc="upper left",
        frameon=False,
        markerscale=3,
        handletextpad=0.2,
        prop={"family": FONT, "size": 10},
    )
    legend.set_zorder(4)


def _warn(axes: Axes, missing: int, cells: int) -> None:
    if missing:
        axes.annotate(
            f"incomplete: {missing:,} of {cells:,} cells are not computed yet",
            (0.5, 0.5),
            xycoords="axes fraction",
            ha="center",
            color="#b2182b",
            fontsize=11,
            fontfamily=FONT,
            bbox={"facecolor": "white", "edgecolor": "#b2182b", "linewidth": 0.6, "alpha": 0.9, "pad": 5},
            zorder=5,
        )
