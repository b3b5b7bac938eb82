"""Thresholds of springs without a sweep, of one and of a grid: in closed form, followed, or searched for."""

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from kernel.cycles.folds import lifetime
from kernel.cycles.thresholds import Thresholds
from kernel.search import EFFORT, starts_of
from service.errors import InvalidRequest
from service.pictures import ATTRACTORS, AXES, IDEAL, Figure, edges, legend_beside, mark_single, values_at
from service.views import proofs
from service.views.springs.queries import ContactQuery, name_of
from service.views.variables import ENERGY, coordinate, dataset, row, variable
from service.views.view import AT_ONCE_SECONDS, SMALL_SECONDS, Call, Estimate, Number, Omega, View, Xi
from worker.analysis.prediction import (
    decides,
    is_ideal,
    of_contact,
    predict,
    prediction_seconds,
    search_below,
)
from worker.spec.axes import Strict, values_of
from worker.spec.contact_models import Contact, Rigid
from worker.sweep import specification

#: Number of springs whose thresholds are kept, the last used.
KEPT: Final = 4096

_OF_SEARCH: Final = (
    row("gone", (), "<f8", "Γ just below down at which a torus or aperiodic motion was seen to end"),
    row("rotation", (), "<f8", "turns of a torus for each round of the cycle in it, from 0 to 1/2"),
    row("rotation_error", (), "<f8", "error of the rotation"),
)

_OF_SPRING: Final = (
    row("threshold", (), "<f8", "Γ at which rest ends; Eq. 25 on an ideal plate", comment="NaN: at none"),
    row("jump", (), "<f8", "Γ of the fold at which flights leap on the way up"),
    row("down", (), "<f8", "lowest Γ at which bouncing persists", comment="NaN: not decided"),
    row("cause", (), "U", "what ends bouncing at down"),
    row("status", (), "U", "how down was found: closed form, continued, searched, or unresolved"),
    row("reason", (), "U", "why down is not decided, or may be lower"),
    row("missed", (), "<f8", "share of all starts of a basin that a search sees with 95 %",
        comment="of starts below the lowest end known, down to 0.3 of it"),
    row("lifetime", (), "<f8", "life of bouncing at Γ = down - delta", "plate periods"),
    row("delta", (), "<f8", "Γ below down"),
    *ENERGY, *_OF_SEARCH, *proofs.OF_THRESHOLD,
)  # fmt: skip


class SearchQuery(ContactQuery):
    """A contact, and whether to search."""

    search: Annotated[
        bool, Field(description="search for what bounces below, by workers, seconds to minutes a spring")
    ] = False
    effort: Annotated[Number, Field(ge=0, le=100)] | None = Field(
        None, description=f"of a search: 100 to 10,000 starts each; default: {EFFORT:g}"
    )

    @field_validator("effort")
    @classmethod
    def _of_a_search(cls, effort: float | None, info: ValidationInfo) -> float | None:
        if effort is not None and not info.data.get("search", True):  # absent if it is no boolean
            raise ValueError("is of a search: add search")
        return effort

    @property
    def tries(self) -> float:
        """The effort of a search, or its default."""
        return EFFORT if self.effort is None else self.effort


class SpringQuery(SearchQuery):
    """A spring, its contact, and how far below the fold it bounces."""

    omega: Omega
    xi: Xi
    delta: Annotated[Number, Field(ge=1e-15, le=0.1, description="Γ below `down` with a lifetime")] = 1e-6
    prove: Annotated[bool, Field(description="an upper bound of `down` with a proof")] = False


#: The thresholds of one spring; `unresolved` or `not searched` where the rule does not decide.
predicted: Final = lru_cache(KEPT)(predict)


def compute_spring(study: None, query: SpringQuery, *computed: Any) -> xarray.Dataset:
    """Where one spring begins and ceases to bounce.

    A rigid contact without restitution has a closed form; with a `model`, workers follow the contact's own
    cycles, in a second or two once compiled. `down` is the lowest Γ at which bouncing persists, by a rule
    that no search contradicts from ξ = 0.04 on. `cause` is `not searched` below that damping, and
    `unresolved` where the rule does not decide. A slow descent ends at `down` or earlier, with the cycle that
    it is on. Below a fold bouncing lives for `lifetime`; the energy balance is that of the cycle at the
    fold. A worker computes what takes longer than a second.

    With `search`, workers try many starts at 30 values of Γ, for seconds to minutes. They follow the cycles
    that transients pass by, and motions that survive, down to their ends. The lowest end is an upper bound
    at any damping; `missed` is the share of starts that a basin must have to be seen with 95 %.
    """
    contact = query.contact()
    *before, search = computed if query.search else (*computed, None)
    thresholds = before[0] if before else predicted(query.omega, query.xi)
    data: dict[str, Any] = {
        "threshold": thresholds.gamma_th if np.isfinite(thresholds.gamma_th) else np.nan,
        "jump": thresholds.jump, "down": thresholds.down,
        "cause": thresholds.cause, "reason": thresholds.reason, "status": _status(contact, thresholds),
    }  # fmt: skip
    gamma, what = np.nan, ""
    if search is not None:
        data["missed"] = search.missed
        rest = thresholds.gamma_th, thresholds.at_rest
        gamma, what = (search.gamma, search.what) if search.what else rest
    if search is not None and not gamma > thresholds.down * _SAME_END:
        data |= {"down": gamma, "cause": what, "status": "searched", "reason": thresholds.cut}
        data |= {row.name: getattr(search, row.name) for row in _OF_SEARCH}
    elif thresholds.fold is not None:
        data |= {"lifetime": lifetime(thresholds.fold, query.delta), "delta": query.delta}
        if thresholds.fold.energy is not None:
            data |= {name: values[0] for name, values in thresholds.fold.energy._asdict().items()}
    if query.prove:
        data |= proofs.of_threshold(query.omega, query.xi, thresholds.fold)
    left_out = (() if query.search else _OF_SEARCH) + (() if query.prove else proofs.OF_THRESHOLD)
    rows = [row for row in _OF_SPRING if row not in left_out]
    return dataset(
        {row.name: variable((), data.get(row.name, np.nan), row) for row in rows},
        {name: coordinate(name, getattr(query, name)) for name in ("omega", "xi")},
        {"model": IDEAL if contact is None else name_of(contact), "complete": True},
    )


def _status(contact: Contact | None, thresholds: Thresholds) -> str:
    """How `down` was found."""
    if not np.isfinite(thresholds.down):
        return "unresolved"
    ideal, fold = contact is None or is_ideal(contact), thresholds.fold
    return "closed form" if ideal and (fold is None or fold.cycle.word == "s") else "continued"


def _calls(query: SpringQuery) -> list[Call]:
    """The calls of a spring for workers: the prediction, and the search if it is asked for."""
    contact, spring = query.contact(), (query.omega, query.xi)
    calls: list[Call] = [(predict, *spring) if contact is None else (of_contact, contact, *spring)]
    if query.search:
        calls.append((search_below, contact or Rigid(), *spring, query.tries))
    return calls


def spring_parts(study: None, query: SpringQuery) -> Sequence[Call]:
    """The calls of the spring; none if the closed form decides, and is quick."""
    spring = query.omega, query.xi
    in_closed_form = query.model is None and not query.search
    quick = in_closed_form and prediction_seconds(*spring) <= AT_ONCE_SECONDS and decides(*spring)
    return () if quick else _calls(query)


def estimate_spring(spec: None, query: SpringQuery) -> Estimate:
    """One number of each variable. Raises InvalidRequest."""
    contact = query.contact()
    if query.prove and (contact is not None or query.search):
        raise InvalidRequest.of("prove", "is of the closed form: leave out model and search")
    brief = contact is None and prediction_seconds(query.omega, query.xi) <= SMALL_SECONDS
    return Estimate({}, small=brief and not query.prove)  # proofs set the precision of the whole process


VIEW: Final = View(
    "threshold", "Thresholds of a spring", None, SpringQuery, compute_spring,
    estimate_spring, variables=_OF_SPRING, parts=spring_parts,
)  # fmt: skip


#: A search has found the end of the rule, or a lower one, if it ends below this multiple of it.
_SAME_END: Final = 1.0 + 1e-9
#: Limit on the core-seconds of a grid; those of a spring, followed, or searched with up to 1,000 starts.
MAX_GRID_SECONDS: Final = 4_000.0
_CONTINUED, _SEARCHED = 1.0, 15.0

#: Bytes per spring in an answer, with statuses as text.
_PER_SPRING: Final = 1_000

#: Variables that only one spring has.
_ALONE: Final = {"lifetime", "delta", *(row.name for row in (*ENERGY, *proofs.OF_THRESHOLD))}
_OF_GRID: Final = tuple(row for row in _OF_SPRING if row.name not in _ALONE)

#: Values in a query; from a sequence the client makes such a text.
Values = Annotated[str, Field(description="values, as 0.45,0.46, or start:stop:number"), Sequence[float]]
#: Limit on the characters of values.
_MOST_TEXT: Final = 32_000


class GridQuery(SearchQuery):
    """Springs, their contact, and whether to search."""

    omega: Values
    xi: Values


class _Axes(Strict):
    """The axes of a grid, each an axis as of a sweep."""

    omega: specification.Omega = 1.0
    xi: specification.Xi = 0.0


def _values(query: GridQuery, name: str) -> NDArray[np.float64]:
    """The values of an axis, as numbers or start:stop:number. Raises InvalidRequest or SpecInvalid."""
    text = getattr(query, name)
    if len(text) > _MOST_TEXT:
        raise InvalidRequest.of(name, "is too long a list: write evenly spaced values as start:stop:number")
    if re.fullmatch(r"\d+,\d+", text.strip()):  # 0,26 is 0.26 to many; 0.5,0.6 and 1, 2 are lists
        rule = f"write a decimal point, as {text.replace(',', '.')}, or a space between two values"
        raise InvalidRequest.of(name, rule)
    axis: Any
    try:
        if "_" in text or not text.isascii():  # Python reads 1_0 and the digits of every script
            raise ValueError
        if ":" in text:
            start, stop, number = text.split(":")
            axis = {"start": float(start), "stop": float(stop), "num": int(number)}
        else:
            axis = [float(part) for part in text.split(",")]
    except ValueError:
        raise InvalidRequest.of(name, "must be numbers, as 0.45,0.46, or start:stop:number") from None
    return values_of(getattr(_Axes(**{name: axis}), name))


def _springs(query: GridQuery) -> list[SpringQuery]:
    """The springs of a grid, omega fastest. Raises InvalidRequest, also for too many, or SpecInvalid."""
    xis, omegas = (_values(query, name).tolist() for name in ("xi", "omega"))
    seconds = _SEARCHED * max(1.0, starts_of(query.tries) / 1_000) if query.search else _CONTINUED
    most = int(MAX_GRID_SECONDS / seconds)
    if len(xis) * len(omegas) > most:
        rule = f"{most:,} springs take {MAX_GRID_SECONDS:,.0f} core-seconds, which is the limit"
        raise InvalidRequest.of("omega", f"must be fewer: {rule}")
    shared = query.model_dump(exclude={"omega", "xi"})
    return [SpringQuery(omega=omega, xi=xi, **shared) for xi in xis for omega in omegas]


def grid_parts(study: None, query: GridQuery) -> Sequence[Call]:
    """The calls of all springs; calls of one function stand together."""
    calls = [_calls(spring) for spring in _springs(query)]
    return [call for step in zip(*calls, strict=True) for call in step]


def compute_grid(study: None, query: GridQuery, *computed: Any) -> xarray.Dataset:
    """Where the springs of a grid of Ω and ξ begin and cease to bounce.

    Workers compute each as `threshold` of one spring. With `search`, `missed` is the share of all starts of
    a basin that the search of a spring sees with 95 %.
    """
    springs = _springs(query)
    results = [compute_spring(None, spring, *computed[i :: len(springs)]) for i, spring in enumerate(springs)]
    axes = {name: coordinate(name, _values(query, name)) for name in ("xi", "omega")}
    shape = tuple(axis.size for axis in axes.values())
    data = {
        row.name: variable(tuple(axes), np.reshape([x[row.name].values for x in results], shape), row)
        for row in _OF_GRID
        if row.name in results[0]
    }
    return dataset(data, axes, results[0].attrs)


def estimate_grid(spec: None, query: GridQuery) -> Estimate:
    """One number of each variable for each spring. Raises InvalidRequest."""
    query.contact()
    sizes = {name: len(_values(query, name)) for name in ("xi", "omega")}
    return Estimate(sizes, memory=_PER_SPRING * len(_springs(query)), small=False)


#: Up to this many values of xi are drawn as lines over omega; more are drawn as a map.
_MOST_LINES: Final = 5


def draw_grid(result: xarray.Dataset, figure: Figure) -> None:
    """Draw the lowest Γ at which bouncing persists: a line over omega for each of a few xi, or a map.

    Diamonds: searched. Dashed: where rest ends. White on a map: not decided.
    """
    axes = figure.subplots()
    axes.set_xlabel(AXES["omega"])
    omega = result.omega.values
    if result.sizes["xi"] > _MOST_LINES:
        ends = edges(omega), edges(result.xi.values)
        shown = axes.pcolormesh(*ends, result.down.values, rasterized=True)
        figure.colorbar(shown, label=r"lowest $\Gamma$ at which bouncing persists")
        mark_single(axes, omega, result.xi.values)
        axes.set_ylabel(AXES["xi"])
        axes.set_title("white: not decided", fontsize=10)
        return
    dash = "_--" if len(omega) == 1 else "--"  # one point has no line
    for i in range(result.sizes["xi"]):
        line, colour = result.isel(xi=i), ATTRACTORS[i]
        searched = line.status.values == "searched"
        down = line.down.values
        axes.plot(omega, down, "-", color=colour, linewidth=1.2, label=values_at(line, ["xi"]))
        axes.plot(omega[~searched], down[~searched], ".", color=colour)
        axes.plot(omega[searched], down[searched], "D", color=colour, fillstyle="none", markersize=5)
        axes.plot(omega, line.threshold.values, dash, color=colour, linewidth=0.9, markersize=12)
    axes.set_ylabel(r"lowest $\Gamma$ at which bouncing persists")
    legend_beside(axes, axes.get_legend_handles_labels()[0])
    searched_for = "; diamonds: searched for" if (result.status.values == "searched").any() else ""
    onset = "Eq. 25" if result.attrs["model"] == IDEAL else "where rest ends"
    axes.set_title(f"dashed: {onset}{searched_for}", fontsize=10)


GRID: Final = View(
    "thresholds", "Thresholds of a grid of springs", None, GridQuery, compute_grid, estimate_grid,
    variables=_OF_GRID, rows="status", printed=("cause",), parts=grid_parts, draw=draw_grid,
)  # fmt: skip
