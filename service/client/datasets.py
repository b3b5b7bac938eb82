"""The service's answers as xarray Datasets with CF attributes.

Every function raises UnexpectedAnswer for an answer of another form.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, TypeAlias

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.labels import LABELS
from kernel.params import Outcome
from service.client import accessor  # noqa: F401 - registers `dataset.bounce`
from service.client.errors import UnexpectedAnswer

Attributes: TypeAlias = Mapping[str, Any]
Variable: TypeAlias = tuple[str | tuple[str, ...], NDArray[Any], dict[str, Any]]

_OUTCOMES: Final = {
    "flag_values": np.array([outcome.value for outcome in Outcome], np.uint8),
    "flag_meanings": " ".join(outcome.name.lower() for outcome in Outcome),
}
_LABELS: Final = {
    "flag_values": np.arange(len(LABELS), dtype=np.uint8),
    "flag_meanings": " ".join(LABELS),
}

_HYSTERESIS: Final = {
    "flag_values": np.arange(3, dtype=np.uint8),
    "flag_meanings": "none other_mode other_flights",
}

#: dtype and attributes of every variable and coordinate of the results of a job.
_RESULTS: Final[Mapping[str, tuple[type, Attributes]]] = {
    "gamma": (np.float64, {"long_name": "plate acceleration Γ = Aω²/g", "units": "1"}),
    "omega": (np.float64, {"long_name": "plate frequency Ω = ω/ω0", "units": "1"}),
    "xi": (np.float64, {"long_name": "damping ratio ξ of the spring", "units": "1"}),
    "flight_time": (np.float64, {"long_name": "flight time", "units": "rad"}),
    "takeoff_phase": (np.float64, {"long_name": "plate phase at take-off", "units": "rad"}),
    "flights": (np.int32, {"long_name": "flights within the observation window", "units": "1"}),
    "outcome": (np.uint8, {"long_name": "outcome of the cell", **_OUTCOMES}),
    "bounces": (np.int32, {"long_name": "bounces of the mode, 0 if none was found", "units": "1"}),
    "periods": (np.int32, {"long_name": "plate periods of the mode, 0 if none was found", "units": "1"}),
    "label": (
        np.uint8,
        {"long_name": "outcome, aperiodic and unstable cells told apart by lyapunov", **_LABELS},
    ),
    "lyapunov": (
        np.float64,
        {
            "long_name": "Lyapunov exponents, the largest first",
            "units": "1",
            "comment": "per plate period, natural logarithm",
        },
    ),
    "lyapunov_error": (
        np.float64,
        {"long_name": "standard error of the largest Lyapunov exponent", "units": "1"},
    ),
    "computed": (np.uint8, {"long_name": "1: computed, 0: taken from its block"}),
    "hysteresis": (np.uint8, {"long_name": "how the ramps up and down compare", **_HYSTERESIS}),
}

_LENGTH: Final = {"units": "plate amplitudes"}

#: Values of one variable; an answer of the service has a million flights.
MAX_VALUES: Final = 100_000_000

#: `admissible` of a point beyond the end of its branch or curve.
MISSING_POINT: Final = 255

_REASONS: Final = {
    "flag_masks": np.array([1, 2, 4], np.uint8),
    "flag_meanings": "gap_negative_in_flight force_negative_in_contact no_takeoff",
    "comment": f"0: admissible; {MISSING_POINT}: no point",
}
_SPEED: Final = {"units": "plate amplitudes per rad"}

#: Variables of a cycle with a value per point of a branch.
_PER_POINT: Final = (
    "gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity", "impact_velocity",
)  # fmt: skip
#: The energy balance of a cycle.
_ENERGY: Final = ("plate_contact", "plate_impact", "dashpot", "impact", "force", "impulse", "weight")

#: dtype and attributes of the variables of cycles in closed form, beside those of _RESULTS.
_CYCLES: Final[Mapping[str, tuple[type, Attributes]]] = {
    "reason": (np.str_, {"long_name": "why there is none"}),
    "elongation": (np.float64, {"long_name": "elongation of the spring at take-off", **_LENGTH}),
    "elongation_velocity": (np.float64, {"long_name": "velocity of the elongation at take-off", **_SPEED}),
    "impact_velocity": (np.float64, {"long_name": "velocity of the gap before landing", **_SPEED}),
    "multiplier": (np.complex128, {"long_name": "Floquet multiplier, the larger in modulus", "units": "1"}),
    "other_multiplier": (np.complex128, {"long_name": "the other Floquet multiplier", "units": "1"}),
    "stable": (np.bool_, {"long_name": "whether both multipliers are inside the unit circle"}),
    "admissible": (np.uint8, {"long_name": "why the cycle is not one of the spring", **_REASONS}),
    "points": (np.int32, {"long_name": "points of the branch", "units": "1"}),
    "kind": (np.str_, {"long_name": "kind of event"}),
    "event_branch": (np.int32, {"long_name": "index of the branch that the event is on", "units": "1"}),
    "word": (np.str_, {"long_name": "landings of the cycle: s sticks, z takes off again at once"}),
    "plate_contact": (np.float64, {"long_name": "work of the plate in contact", "units": "m A² ω²"}),
    "plate_impact": (np.float64, {"long_name": "work of the plate at the impact", "units": "m A² ω²"}),
    "dashpot": (np.float64, {"long_name": "energy that the dashpot takes", "units": "m A² ω²"}),
    "impact": (np.float64, {"long_name": "energy that the impact takes", "units": "m A² ω²"}),
    "force": (np.float64, {"long_name": "momentum that the contact force gives", "units": "m A ω"}),
    "impulse": (np.float64, {"long_name": "momentum that the impact gives", "units": "m A ω"}),
    "weight": (np.float64, {"long_name": "momentum that gravity takes, 4π periods/Γ", "units": "m A ω"}),
}


def orbits_dataset(answer: Mapping[str, Any]) -> xarray.Dataset:
    """Branches of one spring: dims (branch, point), NaN after the last point of a branch, and (event)."""
    with _reading("a list of branches"):
        branches = answer["branches"]
        grid = ("branch", "point")
        variables: dict[str, Any] = {
            name: _cycle_variable(name, grid, _padded([branch[name] for branch in branches]))
            for name in _PER_POINT
        }
        variables |= _stability(branches)
        variables |= _events(answer["events"])
        coordinates = {
            "omega": _variable("omega", None, answer["omega"]),
            "xi": _variable("xi", None, answer["xi"]),
            **{
                name: _variable(name, "branch", [branch[name] for branch in branches])
                for name in ("bounces", "periods")
            },
        }
        return xarray.Dataset(variables, coordinates, _closed_form("branches of a spring"))


def words_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """Branches of words: dims (branch, point, flight), NaN beyond their ends, and (event), (cell)."""
    with _reading("a list of branches of words"):
        branches, events, skipped = answer["branches"], answer["events"], answer["skipped"]
        variables: dict[str, Any] = {
            "gamma": _cycle_variable(
                "gamma", ("branch", "point"), _padded([branch["gamma"] for branch in branches])
            )
        }
        points = max((len(branch["gamma"]) for branch in branches), default=0)
        flights = max((branch["bounces"] for branch in branches), default=0)
        for name in ("flight_time", "takeoff_phase", "impact_velocity"):
            values = np.full(_fitting(len(branches), points, flights), np.nan)
            for row, branch in zip(values, branches, strict=True):
                row[: len(branch["gamma"]), : branch["bounces"]] = branch[name]
            variables[name] = _cycle_variable(name, ("branch", "point", "flight"), values)
        variables |= _stability(branches) | _events(events)
        variables["event_branch"] = _cycle_variable(
            "event_branch", ("event",), [event["branch"] for event in events]
        )
        for name in ("gamma", "bounces", "periods", "reason"):
            column = [cell[name] for cell in skipped]
            variables[f"skipped_{name}"] = _cycle_variable(name, ("cell",), column)
        coordinates = {
            "omega": _variable("omega", None, answer["omega"]),
            "xi": _variable("xi", None, answer["xi"]),
            "direction": _direction(answer),
            "word": _cycle_variable("word", ("branch",), [branch["word"] for branch in branches]),
            **{
                name: _variable(name, "branch", [branch[name] for branch in branches])
                for name in ("bounces", "periods")
            },
        }
        attributes = {**_closed_form("branches of words"), "job": job_id, "complete": int(answer["complete"])}
        return xarray.Dataset(variables, coordinates, attributes)


def curves_dataset(answer: Mapping[str, Any]) -> xarray.Dataset:
    """Curves of events: dims (curve, point), NaN after the last point of a curve, and (event)."""
    with _reading("a list of curves"):
        along, curves = str(answer["along"]), answer["curves"]
        fixed = "xi" if along == "omega" else "omega"
        grid = ("curve", "point")
        variables: dict[str, Any] = {
            name: _cycle_variable(name, grid, _padded([curve[name] for curve in curves]))
            for name in (along, "gamma", "flight_time")
        }
        padded = _padded([curve["admissible"] for curve in curves])
        admissible = np.where(np.isnan(padded), MISSING_POINT, padded)
        variables["admissible"] = _cycle_variable("admissible", grid, admissible)
        variables |= _events(answer["points"])
        coordinates = {
            fixed: _variable(fixed, None, answer[fixed]),
            "kind": _cycle_variable("kind", ("curve",), [curve["kind"] for curve in curves]),
            **{
                name: _variable(name, "curve", [curve[name] for curve in curves])
                for name in ("bounces", "periods")
            },
        }
        return xarray.Dataset(variables, coordinates, _closed_form("bifurcation curves"))


def _stability(branches: Sequence[Mapping[str, Any]]) -> dict[str, Variable]:
    """What branches of all kinds have with dims (branch, point), and the points of each."""
    grid = ("branch", "point")
    counts = np.array([len(branch["gamma"]) for branch in branches], np.intp)
    shape = _fitting(len(branches), int(counts.max(initial=0)), 2)
    multipliers = np.full(shape, np.nan, np.complex128)
    for row, branch in zip(multipliers, branches, strict=True):
        if branch["multipliers"]:
            parts = np.array(branch["multipliers"], np.float64)
            row[: len(parts)] = parts[..., 0] + 1j * parts[..., 1]
    variables = {"points": _cycle_variable("points", ("branch",), counts)}
    for i, name in enumerate(("multiplier", "other_multiplier")):
        variables[name] = _cycle_variable(name, grid, multipliers[..., i])
    for name, fill in (("stable", 0), ("admissible", MISSING_POINT)):
        padded = _padded([branch[name] for branch in branches])
        variables[name] = _cycle_variable(name, grid, np.where(np.isnan(padded), fill, padded))
    if branches and branches[0].get("energy") is not None:
        for name in _ENERGY:
            rows = _padded([branch["energy"][name] for branch in branches])
            variables[name] = _cycle_variable(name, grid, rows)
    return variables


def _events(events: Sequence[Mapping[str, Any]]) -> dict[str, Variable]:
    """Variables `event_gamma`, `event_kind` and so on, with dim event."""
    return {
        f"event_{name}": _cycle_variable(name, ("event",), [event[name] for event in events])
        for name in (
            "kind", "gamma", "omega", "xi", "bounces", "periods", "flight_time", "admissible",
        )
    }  # fmt: skip


def _cycle_variable(name: str, dims: tuple[str, ...], values: object) -> Variable:
    dtype, attributes = {**_RESULTS, **_CYCLES}[name]
    return dims, np.asarray(values, dtype), dict(attributes)


def _closed_form(title: str) -> dict[str, Any]:
    return {
        "Conventions": "CF-1.11",
        "title": title,
        "source": "bouncing-spring, closed form",
        "model": "rigid, restitution 0",
    }


def _number(value: float | None) -> float:
    return np.nan if value is None else value


@contextmanager
def _reading(kind: str) -> Iterator[None]:
    """Turn the errors of reading an answer of another form into UnexpectedAnswer."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise UnexpectedAnswer(f"the answer is not {kind}: {error!r}") from error


def _dataset(
    variables: Mapping[str, Any],
    coordinates: Mapping[str, Any],
    answer: Mapping[str, Any],
    title: str,
    job_id: str,
) -> xarray.Dataset:
    return xarray.Dataset(
        variables,
        coordinates,
        {
            "Conventions": "CF-1.11",
            "title": title,
            "source": "bouncing-spring",
            "job": job_id,
            "complete": int(answer["complete"]),  # NetCDF has no booleans
        },
    )


def _variable(field: str, dim: str | tuple[str, ...] | None, values: object) -> Variable:
    dtype, _ = _RESULTS[field]
    return (() if dim is None else dim), np.asarray(values, dtype), _attributes(field)


def _direction(answer: Mapping[str, Any]) -> Variable:
    return (), np.array(str(answer["direction"])), {"long_name": "direction of the ramp"}


def _attributes(field: str) -> dict[str, Any]:
    return dict(_RESULTS[field][1])


def _with_nan(values: Sequence[float | None]) -> NDArray[np.float64]:
    """The numbers, NaN in place of null."""
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _fitting(*shape: int) -> tuple[int, ...]:
    """The shape. Raises ValueError for more than MAX_VALUES: a short answer can ask for them."""
    if math.prod(shape) > MAX_VALUES:
        raise ValueError(f"{' x '.join(map(str, shape))} values; at most {MAX_VALUES:,} are read")
    return shape


def _padded(rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """(n, length of the longest row), NaN after the end of each row."""
    lengths = np.array([len(row) for row in rows], np.intp)
    width = int(lengths.max(initial=0))
    table = np.full(_fitting(len(rows), width), np.nan)
    table[np.arange(width) < lengths[:, None]] = [flight for row in rows for flight in row]
    return table
