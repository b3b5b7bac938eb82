"""Curves of the events of a spring's cycles over one of its parameters, in closed form or followed."""

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
import xarray
from pydantic import Field

from kernel.cycles.curves import Curves, Parameter, curves
from kernel.cycles.events import KINDS, Kind, join_events, rows_of
from kernel.cycles.follow import End
from service.errors import InvalidRequest
from service.pictures import ATTRACTORS, AXES, IDEAL, Figure, legend_beside, values_at
from service.views.springs.branches import EVENTS, ROWS, below, columns, cycle_result, event_columns, padded
from service.views.springs.queries import (
    GAMMA_MAX,
    ContactQuery,
    Gamma,
    Modes,
    grid_length,
    name_of,
    parse_modes,
)
from service.views.variables import coordinate
from service.views.view import Call, Estimate, Omega, View, Xi
from worker.analysis.cycles import CONTACT_CURVES, curves_seconds, follow_curves
from worker.spec.errors import one_of

#: Limit on the core-seconds of an answer. Core-seconds of a mode per flight time of its branch, at the
#: smaller omega.
MAX_SECONDS: Final = 60.0
_SECONDS: Final = 0.01

#: Estimated bytes and points of an answer: the length of curves is known only once they are followed.
_MEMORY: Final = 64 * 2**20
_POINTS: Final = 4_000

Span = tuple[float, float]


class CurvesQuery(ContactQuery):
    """A range of Ω at one ξ, or of ξ at one Ω."""

    omega: Omega | None = None
    xi: Xi | None = None
    omega_start: Omega | None = None
    omega_stop: Omega | None = None
    xi_start: Xi | None = None
    xi_stop: Xi | None = None
    modes: Modes = "1-1,1-2"
    kinds: Annotated[str | None, Field(max_length=200, description="such as fold,flip; default: all")] = None
    gamma_max: Annotated[Gamma, Field(description="curves are cut above this Γ")] = GAMMA_MAX


def _plane(query: CurvesQuery) -> tuple[Parameter, float, Span]:
    """The parameter that varies, the value of the other, and the range. Raises InvalidRequest."""
    over_omega = (query.xi, query.omega_start, query.omega_stop)
    over_xi = (query.omega, query.xi_start, query.xi_stop)
    match over_omega, over_xi:
        case (float(fixed), float(low), float(high)), (None, None, None):
            along = Parameter.OMEGA
        case (None, None, None), (float(fixed), float(low), float(high)):
            along = Parameter.XI
        case _:
            rule = "give xi, omega_start and omega_stop, or omega, xi_start and xi_stop"
            raise InvalidRequest.of("xi" if query.omega is None else "omega", rule)
    if not low < high:
        raise InvalidRequest.of(f"{along}_stop", f"must be above {along}_start, {low!r}")
    return along, fixed, (low, high)


def _kinds(query: CurvesQuery) -> tuple[Kind, ...]:
    """Kinds of curves, written as `fold,flip`. Raises InvalidRequest."""
    possible = KINDS if query.model is None else CONTACT_CURVES
    if query.kinds is None:
        return possible
    names = [name.strip() for name in query.kinds.split(",")]
    unknown = [name for name in names if name not in possible]
    if unknown:
        raise InvalidRequest.of("kinds", f"must be among {one_of(possible)}, not {unknown[0][:40]!a}")
    return tuple(kind for kind in possible if kind in names)


def parts(study: None, query: CurvesQuery) -> Sequence[Call]:
    """The curves of each mode."""
    along, fixed, span = _plane(query)
    kinds, contact, modes = _kinds(query), query.contact(), parse_modes(query.modes)
    if contact is None:
        return [(curves, along, fixed, *span, periods, kinds) for periods in modes]
    top = query.gamma_max
    return [(follow_curves, contact, along, fixed, span, periods, kinds, top) for periods in modes]


def compute(study: None, query: CurvesQuery, *parts: Curves) -> xarray.Dataset:
    """Curves of folds, flips and other events over Ω or ξ.

    The range is of one of them, at one value of the other. The events are the cusps, Bogdanov-Takens and
    fold-flip points at which curves meet or turn. Workers compute the curves, some seconds for each mode.
    With a `model` they are the folds and flips of its own cycles, and end at cusps and where the segments
    of a cycle change. The events are then where branches with too many points are `cut-off`.
    """
    along, fixed, _ = _plane(query)
    top = query.gamma_max
    pieces = [piece for part in parts for curve in part.curves for piece in below(curve, top)]
    data = padded((along, "gamma", "flight_time", "violations"), pieces, ("curve", "point"))
    events = join_events([part.points for part in parts])
    # a branch may be cut off on its way to `top`
    data |= event_columns(rows_of(events, (events.gamma <= top) | (events.kind == End.CUT_OFF)))
    names = ("kind", "bounces", "periods")
    coords = columns("curve", {name: [getattr(piece, name)[0] for piece in pieces] for name in names})
    other = "xi" if along is Parameter.OMEGA else "omega"
    coords |= {other: coordinate(other, fixed)}
    contact = query.contact()
    model = IDEAL if contact is None else name_of(contact)
    return cycle_result(data, coords, model=model, along=str(along), gamma_max=top)


def estimate(spec: None, query: CurvesQuery) -> Estimate:
    """The typical size. Raises InvalidRequest for a query without a plane, and above MAX_SECONDS."""
    along, fixed, span = _plane(query)
    _kinds(query)
    contact = query.contact()
    modes = parse_modes(query.modes)
    springs = [(value, fixed) if along is Parameter.OMEGA else (fixed, value) for value in span]
    field = "omega_start" if along is Parameter.OMEGA else "omega"
    lengths = [[grid_length(*spring, periods, field=field) for spring in springs] for periods in modes]
    omega, _ = springs[0]
    closed_form = [_SECONDS * at_start for at_start, _ in lengths]
    followed = [] if contact is None else [curves_seconds(contact)] * len(modes)
    seconds = np.cumsum(followed or closed_form)
    if seconds[-1] > MAX_SECONDS:
        fitting = int(np.searchsorted(seconds, MAX_SECONDS, "right"))
        ways = [f"ask for the first {fitting}"] if fitting else []
        ways.append("take a smaller restitution" if followed else "take a larger omega")
        rule = (
            f"their curves from omega {omega:g} on take about {seconds[-1]:.0f} core-seconds, the limit for "
            f"one answer is {MAX_SECONDS:g}: {', or '.join(ways)}"
        )
        raise InvalidRequest.of("modes", rule)
    return Estimate({"curve": len(modes), "point": _POINTS}, memory=_MEMORY, small=False)


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw Γ of every curve, each kind in its colour; dotted where the cycle is not admissible."""
    axes, along = figure.subplots(), result.attrs["along"]
    colours = {str(kind): colour for kind, colour in zip(KINDS, ATTRACTORS, strict=False)}
    for i in range(result.sizes["curve"]):
        curve = result.isel(curve=i)
        colour, admissible = colours[curve.curve_kind.item()], curve.violations.values == 0
        for shown, style in ((admissible, "-"), (~admissible, ":")):
            axes.plot(curve[along].values, np.where(shown, curve.gamma.values, np.nan), style, color=colour)
    for kind in sorted(set(result.curve_kind.values.tolist())):
        axes.plot([], [], color=colours[kind], label=kind)
    legend_beside(axes, axes.get_legend_handles_labels()[0])
    other = "xi" if along == "omega" else "omega"
    title, model = values_at(result, [other]), result.attrs["model"]
    title += "" if model == IDEAL else f": {model}"
    title += "; dotted: not admissible" if (result.violations.where(result.gamma.notnull()) > 0).any() else ""
    title += "; branches were cut off" if (result.event_kind == End.CUT_OFF).any() else ""
    axes.set(xlabel=AXES[along], ylabel=AXES["gamma"], title=title)


VIEW: Final = View(
    "curves", "Bifurcation curves", None, CurvesQuery, compute, estimate,
    variables=(
        *(ROWS[name] for name in ("omega", "xi", "gamma", "flight_time", "violations")),
        *(ROWS[f"curve_{name}"] for name in ("kind", "bounces", "periods")), *EVENTS,
    ),
    rows="gamma", printed=("gamma", "event_gamma"), parts=parts, draw=draw,
)  # fmt: skip
