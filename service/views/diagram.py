"""Bifurcation diagrams: the flights of all cells along one axis of the grid."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import ModuleType
from typing import Annotated, Any, Final, Literal

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field

from kernel.labels import CHAOTIC, LABELS, QUASI_PERIODIC, UNSTABLE
from kernel.modes import counted
from kernel.params import Outcome
from service import pictures
from service.errors import InvalidRequest
from service.views import orbits as cell_orbits
from service.views import selection
from service.views.springs import orbits
from service.views.springs.branches import ROWS
from service.views.springs.queries import MAX_GAMMA
from service.views.variables import cells_dataset, coordinate
from service.views.view import Call, Direction, Estimate, Every, Hide, Log, MinFlight, Number, Query, View
from worker.spec.contact_models import CONTACT_MODELS, Rigid, Soft, Stepped
from worker.study import Array
from worker.sweep import AXES, SweepSpec, schema


class DiagramQuery(Query):
    """One line of the grid along one axis; the other axes take the nearest grid value."""

    along: Annotated[Literal["gamma", "omega", "xi"], Field(description="axis of the diagram")] = "gamma"
    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: Direction = None
    min_flight: MinFlight = None
    every: Every = 1
    log: Log = None
    start: Annotated[Number | None, Field(description="smallest value of the axis")] = None
    stop: Annotated[Number | None, Field(description="largest value of the axis")] = None
    flight_start: Annotated[Number | None, Field(description="rad, shortest flight shown")] = None
    flight_stop: Annotated[Number | None, Field(description="rad, longest flight shown")] = None
    hide: Hide = None
    caption: Annotated[bool, Field(description="whether a picture says how it was computed")] = True
    branches: Annotated[
        bool,
        Field(
            description="cycles, stable and unstable: along gamma of one bounce, up to three periods, else "
            "those that cells settled to; not in tables"
        ),
    ] = False


#: Cycles whose branches are in a diagram, and up to how many times its highest Γ they are followed, so that
#: none ends within it. The page asks for the same.
_CYCLES: Final = "1-1,1-2,1-3"
_BEYOND: Final = 2.0
#: Their variables in a diagram, by the names that a result of orbits has.
_OF_BRANCHES: Final = {
    name: ROWS[name]._replace(name=f"branch_{name.removeprefix('branch_')}", dims=dims)
    for dims, names in (
        (("branch",), ("branch_bounces", "branch_periods")),
        (("branch", "point"), ("gamma", "omega", "xi", "flight_time", "stable", "violations")),
    )
    for name in names
}


def _branches(spec: SweepSpec, query: DiagramQuery) -> tuple[ModuleType, Any] | None:
    """The module whose result has the branches in a diagram, and its query; None without branches.

    Along gamma of the sweep's contact, if its cycles can be followed, else of an ideal plate; along another
    axis those of its cells. Raises InvalidRequest.
    """
    if not query.branches:
        return None
    if query.along != "gamma":
        line = query.model_dump(include={"along", *AXES, "direction"})
        return cell_orbits, cell_orbits.CellsQuery(**line)
    if not isinstance(spec.model, Rigid | Soft | Stepped):
        raise InvalidRequest.of("branches", "are of rigid, soft and stepped contacts")
    fixed = {axis: point.value for axis, point in selection.fixed_axes(spec, query).items()}
    model = spec.model.exact
    own = model.model_dump(include={"restitution", "penetration", "adhesive"}) | {"model": model.kind}
    gamma = spec.axis_values("gamma")
    shown = gamma[_window(spec, query)].tolist()
    window = query.model_dump(include=set(orbits.WINDOW)) | {"start": shown[0], "stop": shown[-1]}
    own_or_window = own if model.has_own_cycles else window
    top = min(_BEYOND * float(gamma[-1]), MAX_GAMMA)
    return orbits, orbits.OrbitsQuery(**fixed, **own_or_window, modes=_CYCLES, gamma_max=top)


def parts(study: selection.Stored[SweepSpec], query: DiagramQuery) -> Sequence[Call]:
    """The branches that workers follow."""
    if (branches := _branches(study.spec, query)) is None:
        return []
    of, wanted = branches
    calls: Sequence[Call] = of.parts(study, wanted)
    return calls


def compute(study: selection.Stored[SweepSpec], query: DiagramQuery, *followed: Any) -> xarray.Dataset:
    """The flights of the cells along an axis.

    A sweep ramped both ways has the dimension `direction`, unless one is selected. Flights up to
    `min_flight` are NaN and do not count for `outcome`, `bounces` and `periods`, unless a cell has no longer
    ones. Flights outside the window, and all flights of classes to `hide`, are NaN too.
    """
    spec, along = study.spec, query.along
    fixed, window = selection.fixed_axes(spec, query), _window(spec, query)
    part = slice(window.start, window.stop, query.every)
    indices = {along: part, **{axis: point.index for axis, point in fixed.items()}}
    cells = {
        direction: _shown(_read_line(study, direction, indices, query.min_flight), query)
        for direction in selection.directions_of(spec, query.direction)
    }
    coords = {axis: coordinate(axis, point.value) for axis, point in fixed.items()}
    coords |= {along: coordinate(along, spec.axis_values(along)[part])}
    attrs: dict[str, Any] = {
        "along": along, "min_flight": selection.shortest(spec, query.min_flight), "every": query.every,
        "model": spec.model.kind, "complete": all(study.is_complete(x["outcome"]) for x in cells.values()),
    }  # fmt: skip
    ends = {"flight_start": query.flight_start, "flight_stop": query.flight_stop}
    attrs |= {name: value for name, value in ends.items() if value is not None}
    attrs |= query.model_dump(include={"hide", "log"}, exclude_none=True)
    result = cells_dataset(cells, coords, rows_of(spec), attrs)
    if (branches := _branches(spec, query)) is not None:
        of, wanted = branches
        is_own = of is cell_orbits or wanted.model is not None or spec.model == Rigid()
        result = _with_branches(result, of.compute(study, wanted, *followed), is_own)
    if query.caption:
        result.attrs["caption"] = _caption(spec, result)
    return result


def _with_branches(result: xarray.Dataset, cycles: xarray.Dataset, is_own: bool) -> xarray.Dataset:
    """A diagram with branches; of several flights of a cycle, with the longest."""
    x = {name: cycles.variables[name] for name in _OF_BRANCHES if "branch" in cycles.variables[name].dims}
    if "flight" in x["flight_time"].dims:
        longest = x["flight_time"].values[..., :1]
        x["flight_time"] = xarray.Variable(("branch", "point"), longest.reshape(longest.shape[:2]))
    branches = {_OF_BRANCHES[name].name: variable for name, variable in x.items()}
    return result.assign(branches).assign_attrs(branches=cycles.attrs["model"], own_branches=is_own)


def _window(spec: SweepSpec, query: DiagramQuery) -> range:
    return selection.between(spec.axis_values(query.along), query, "start", "stop")


def rows_of(spec: SweepSpec) -> Iterator[Array]:
    """The stored variables without the end states, and the label where exponents are stored."""
    yield from (row for row in schema.arrays(spec) if row is not schema.END_STATE)
    if spec.exponents:
        yield selection.LABEL


def _read_line(
    study: selection.Stored[SweepSpec], direction: str, indices: Any, min_flight: float | None
) -> dict[str, NDArray[Any]]:
    spec = study.spec
    names = [row.name for row in rows_of(spec) if row is not selection.LABEL]
    arrays = selection.read_direction(study, names, direction, indices)
    arrays |= selection.recounted(spec, arrays, min_flight)
    shown = counted(arrays["flight_time"], arrays["flights"], selection.shortest(spec, min_flight))
    for name in ("flight_time", "takeoff_phase"):
        arrays[name] = np.where(shown, arrays[name], np.nan)
    return arrays


def _shown(arrays: dict[str, NDArray[Any]], query: DiagramQuery) -> dict[str, NDArray[Any]]:
    """The variables, with NaN for flights outside the window and of hidden cells."""
    times, low, high = arrays["flight_time"], query.flight_start, query.flight_stop
    shown = (times >= (-np.inf if low is None else low)) & (times <= (np.inf if high is None else high))
    masks = {"flight_time": shown, "takeoff_phase": shown}
    if query.hide is not None:
        seen = ~selection.hidden_cells(arrays, query.hide)
        shown &= seen[..., np.newaxis]
        masks |= {"lyapunov": seen[..., np.newaxis], "lyapunov_error": seen}
    kept = {name: np.where(mask, arrays[name], np.nan) for name, mask in masks.items() if name in arrays}
    return arrays | kept


def estimate(spec: SweepSpec, query: DiagramQuery) -> Estimate:
    """All flights that the line can have. Raises InvalidRequest if the sweep lacks the line."""
    selection.fixed_axes(spec, query)
    selection.check_order(query, "flight_start", "flight_stop", wide=True)
    branches = _branches(spec, query)
    try:
        followed = Estimate({}) if branches is None else branches[0].estimate(spec, branches[1])
    except InvalidRequest as error:
        raise InvalidRequest.of("branches", f"are not available: {error}") from error
    directions = selection.directions_of(spec, query.direction)
    lengths = {query.along: len(_window(spec, query)), "flight": spec.keep}
    if len(directions) > 1:
        lengths = {"direction": len(directions), **lengths}
    return replace(followed, lengths=lengths, thinned=(query.along,), every=query.every, reads=(query.along,))


def _caption(spec: SweepSpec, result: xarray.Dataset) -> str:
    """How the cells were computed, and which of them are shown."""
    attrs, outcome = result.attrs, result.variables["outcome"].values
    [way, *other] = np.atleast_1d(result.direction.values)
    ramped = "ramped" if other else f"ramped {way}"
    start = "from rest" if spec.ramp_axis is None else f"{ramped} along {spec.ramp_axis}"
    flights = f", flights above {attrs['min_flight']:g} rad" if attrs["min_flight"] else ""
    thinned = f", 1 cell in {attrs['every']:,}" if attrs["every"] > 1 else ""
    skips = "computed" in result
    done = f", {int(result.computed.sum()):,} of {outcome.size:,} cells computed" if skips else ""
    lost = int(np.count_nonzero(np.isin(outcome, (Outcome.UNRESOLVED, Outcome.DIVERGED))))
    unresolved = f", {lost:,} of {outcome.size:,} cells unresolved" if lost else ""
    codes = result.variables[selection.LABEL.name if selection.LABEL.name in result else "outcome"].values
    special = (Outcome.SETTLING, QUASI_PERIODIC, CHAOTIC, UNSTABLE)
    counts = {code: int(np.count_nonzero(codes == code)) for code in special}
    labelled = "".join(f", {count:,} {LABELS[code]}" for code, count in counts.items() if count)
    return f"{CONTACT_MODELS[spec.model.kind].label}, {start}{flights}{thinned}{done}{unresolved}{labelled}"


#: Size of the picture, inches.
SIZE: Final = (8.6, 4.2)


def draw(result: xarray.Dataset, figure: pictures.Figure) -> None:
    """Draw the flight times along the axis, and write how many cells are missing; below, any exponents."""
    ratios = (2, 1) if "lyapunov" in result else (2,)
    figure.set_figheight(0.5 * sum(ratios) * SIZE[1])
    axes, *below = figure.subplots(len(ratios), sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
    pictures.draw_diagram(axes, result)
    scale = axes.xaxis.get_transform()
    low, high = scale.transform(axes.get_xlim())
    dot = pictures.dot_of(result.sizes[result.attrs["along"]])
    room = 0.002 * dot * (high - low)  # for half a dot at each end
    left, right = scale.inverted().transform([low - room, high + room])
    axes.set_xlim(left if left > 0.0 else None, right)
    pictures.draw_strips(axes, result)
    for panel in below:
        pictures.draw_exponents(panel, result)
        panel.set(title="", ylabel=r"$\lambda$ (per plate period)")
        axes.set_xlabel("")
    if "caption" in result.attrs:
        pictures.draw_caption(axes, result)
    if not result.attrs["complete"]:
        missing = int(np.count_nonzero(result.outcome.values == Outcome.MISSING))
        total = result.outcome.size
        reason = f"{missing:,} of {total:,} cells are not computed yet" if missing else "being repaired"
        pictures.draw_incomplete(axes, reason)


VIEW: Final = View(
    "diagram", "Bifurcation diagram", SweepSpec, DiagramQuery, compute, estimate,
    variables=(
        *(row for row in schema.ARRAYS if row is not schema.END_STATE), selection.LABEL,
        *_OF_BRANCHES.values(),
    ),
    rows="flight_time", draw=draw, size=SIZE, activity="read", parts=parts,
)  # fmt: skip
