"""A basin as JSON and as a picture with its attractors and their shares."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from kernel.params import STATE_FIELDS
from service.formats import PictureFormat
from service.render.style import SYMBOLS, TEXT, Origin, encode
from service.render.text import to_json
from service.results.basins import Attractor, BasinCell

#: Inches.
SIZE: Final = (6.8, 4.2)

#: Colours of the attractors in the order of their ids, repeated beyond (Okabe and Ito); of undecided starts.
COLOURS: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#666666")
UNDECIDED: Final = "#ffffff"

#: Attractors named beside the picture, and how many of these have room for two lines each.
NAMED: Final = 16
ROOMY: Final = 7

_AXES: Final = {
    "drop": ("phase of the plate when let go (rad)", "height above the plate (plate amplitudes)"),
    "contact": (r"$\Omega\,q'$ (plate amplitudes)", r"$q$ beyond the static elongation (plate amplitudes)"),
}


def basin_json(cell: BasinCell) -> bytes:
    """The basin as a JSON document."""
    plane = cell.spec.protocol
    return to_json(
        {
            "gamma": cell.gamma,
            "omega": cell.omega,
            "xi": cell.xi,
            "plane": plane.plane,
            "height": plane.height,
            "rows": plane.row_values.tolist(),
            "columns": plane.column_values.tolist(),
            "attractors": [_attractor(attractor) for attractor in cell.attractors],
            "map": cell.map.tolist(),
            **{name: cell.numbers.get(name) for name in ("undecided", "basin_entropy", "boundary_entropy")},
            "complete": cell.complete,
        }
    )


def _attractor(attractor: Attractor) -> dict[str, Any]:
    exponents = {} if attractor.lyapunov is None else {"lyapunov": attractor.lyapunov.tolist()}
    return {
        "id": attractor.id,
        "fraction": attractor.fraction,
        "outcome": attractor.outcome,
        "label": attractor.label,
        "bounces": attractor.bounces,
        "periods": attractor.periods,
        "longest_flight": attractor.longest_flight,
        "lifetime": attractor.lifetime,
        "state": dict(zip(STATE_FIELDS, attractor.state.tolist(), strict=True)),
        "flight_time": attractor.flight_time.tolist(),
        "takeoff_phase": attractor.takeoff_phase.tolist(),
        **exponents,
    }


def draw(cell: BasinCell, format: PictureFormat, origin: Origin) -> bytes:
    """A picture of the plane of starts, each in the colour of its attractor."""
    return encode(SIZE, lambda figure: _draw(figure, cell), format, origin)


def _draw(figure: Figure, cell: BasinCell) -> None:
    axes = figure.subplots()
    plane = cell.spec.protocol
    colours = [COLOURS[i % len(COLOURS)] for i in range(len(cell.attractors))]
    axes.imshow(
        cell.map, origin="lower", aspect="auto", interpolation="nearest", extent=_extent(cell),
        cmap=ListedColormap([UNDECIDED, *colours]), vmin=-0.5, vmax=len(colours) + 0.5,
    )  # fmt: skip
    along, across = _AXES[plane.plane]
    axes.set_xlabel(along, **TEXT)
    axes.set_ylabel(across, **TEXT)
    for tick in (*axes.get_xticklabels(), *axes.get_yticklabels()):
        tick.set(**TEXT)
    values = ", ".join(f"{SYMBOLS[name]} = {getattr(cell, name):g}" for name in ("gamma", "omega", "xi"))
    axes.set_title(f"{values}  ({cell.spec.model.kind})", fontsize=11, **TEXT)
    _legend(axes, cell, colours)


def _extent(cell: BasinCell) -> tuple[float, float, float, float]:
    """Left, right, bottom, top: every start is the middle of its pixel."""
    plane = cell.spec.protocol
    ends: list[float] = []
    for values in (plane.column_values, plane.row_values):
        step = values[1] - values[0] if len(values) > 1 else 1.0
        ends += [float(values[0] - 0.5 * step), float(values[-1] + 0.5 * step)]
    return ends[0], ends[1], ends[2], ends[3]


def _legend(axes: Axes, cell: BasinCell, colours: list[str]) -> None:
    close = len(cell.attractors) > ROOMY
    between = ", " if close else "\n"
    entries = [
        Patch(
            color=colour,
            label=f"{attractor.label}  {_percent(attractor.fraction)}{_longest(attractor, between)}",
        )
        for attractor, colour in zip(cell.attractors[:NAMED], colours, strict=False)
    ]
    undecided = float(cell.numbers.get("undecided", 1.0))
    if undecided > 0.0:
        text = "not computed" if not cell.numbers else f"undecided  {_percent(undecided)}"
        entries.append(Patch(facecolor=UNDECIDED, edgecolor="black", linewidth=0.5, label=text))
    if len(cell.attractors) > NAMED:
        entries.append(Patch(alpha=0.0, label=f"and {len(cell.attractors) - NAMED} more"))
    axes.legend(
        handles=entries, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False,
        prop={"family": "STIXGeneral", "size": 10}, labelspacing=0.2 if close else None,
    )  # fmt: skip


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %" if np.isfinite(share) and share >= 0.001 else f"{100.0 * share:.2g} %"


def _longest(attractor: Attractor, between: str) -> str:
    return f"{between}up to {attractor.longest_flight:.4g} rad" if attractor.longest_flight > 0.0 else ""
