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
    "analytic": (np.float64, {"long_name": "threshold Γ from rest by Eq. 25", "units": "1"}),
    "up": (np.float64, {"long_name": "lowest Γ that bounces, ascending or from rest", "units": "1"}),
    "down": (np.float64, {"long_name": "lowest Γ that bounces, descending", "units": "1"}),
    "predicted_jump": (np.float64, {"long_name": "Γ of the fold at which flights leap", "units": "1"}),
    "predicted_down": (np.float64, {"long_name": "Γ at which bouncing ends, predicted", "units": "1"}),
    "cause": (np.str_, {"long_name": "what ends bouncing on the way down"}),
    "difference": (np.str_, {"long_name": "why down and predicted_down differ"}),
    "up_computed": (np.bool_, {"long_name": "whether both cells beside up were computed"}),
    "computed": (np.uint8, {"long_name": "1: computed, 0: taken from its block"}),
    "hysteresis": (np.uint8, {"long_name": "how the ramps up and down compare", **_HYSTERESIS}),
    "up_status": (np.str_, {"long_name": "why up is a number or NaN"}),
    "down_status": (np.str_, {"long_name": "why down is a number or NaN"}),
}

_LENGTH: Final = {"units": "plate amplitudes"}

#: Values of one variable; an answer of the service has a million flights.
MAX_VALUES: Final = 100_000_000

#: The energy balance of a cycle.
_ENERGY: Final = ("plate_contact", "plate_impact", "dashpot", "impact", "force", "impulse", "weight")

#: dtype and attributes of the variables of cycles in closed form, beside those of _RESULTS.
_CYCLES: Final[Mapping[str, tuple[type, Attributes]]] = {
    "threshold": (np.float64, {"long_name": "Γ at which rest ends, Eq. 25", "units": "1"}),
    "jump": (np.float64, {"long_name": "Γ of the fold at which flights leap on the way up", "units": "1"}),
    "down": (np.float64, {"long_name": "lowest Γ at which anything bounces for ever", "units": "1"}),
    "reason": (np.str_, {"long_name": "why there is none"}),
    "lifetime": (np.float64, {"long_name": "life of bouncing at Γ = down - delta", "units": "plate periods"}),
    "delta": (np.float64, {"long_name": "Γ below down", "units": "1"}),
    "plate_contact": (np.float64, {"long_name": "work of the plate in contact", "units": "m A² ω²"}),
    "plate_impact": (np.float64, {"long_name": "work of the plate at the impact", "units": "m A² ω²"}),
    "dashpot": (np.float64, {"long_name": "energy that the dashpot takes", "units": "m A² ω²"}),
    "impact": (np.float64, {"long_name": "energy that the impact takes", "units": "m A² ω²"}),
    "force": (np.float64, {"long_name": "momentum that the contact force gives", "units": "m A ω"}),
    "impulse": (np.float64, {"long_name": "momentum that the impact gives", "units": "m A ω"}),
    "weight": (np.float64, {"long_name": "momentum that gravity takes, 4π periods/Γ", "units": "m A ω"}),
}

#: dtype, value where there is none, and attributes of the attractors of each cell of a grid.
_PLACES: Final[Mapping[str, tuple[type, Any, Attributes]]] = {
    "id": (np.int32, 0, {"long_name": "attractor of the cell", "comment": "0: none", "units": "1"}),
    "label": (np.str_, "", {"long_name": "what the attractor does"}),
    "fraction": (np.float64, np.nan, {"long_name": "share of the drops that reach it", "units": "1"}),
    "longest_flight": (np.float64, np.nan, {"long_name": "longest flight", "units": "rad"}),
}

#: Field, dtype and value where there is none of the variables of events of attractors.
_EVENTS: Final[Mapping[str, tuple[str, type, Any]]] = {
    "kind": ("kind", np.str_, ""),
    "event_attractor": ("attractor", np.int32, 0),
    "event_omega": ("omega", np.float64, np.nan),
    "gamma_below": ("gamma_below", np.float64, np.nan),
    "gamma_above": ("gamma_above", np.float64, np.nan),
    "below": ("below", np.str_, ""),
    "above": ("above", np.str_, ""),
    "leads_to": ("leads_to", np.int32, 0),
}

#: The samples of a trajectory, with dim phase.
_SAMPLES: Final[Mapping[str, Attributes]] = {
    "plate": {"long_name": "plate", **_LENGTH},
    "z1": {"long_name": "upper mass", **_LENGTH},
    "z2": {"long_name": "lower mass", **_LENGTH},
    "force": {"long_name": "force of the plate on the lower mass", "units": "m A ω²"},
    "in_flight": {"long_name": "whether the spring is off the plate"},
}

#: The flights of a trajectory, with dim flight.
_FLIGHTS: Final[Mapping[str, Attributes]] = {
    "takeoff": {"long_name": "plate phase at take-off, with whole periods as of the samples", "units": "rad"},
    "takeoff_phase": {"long_name": "plate phase at take-off", "units": "rad"},
    "flight_time": {"long_name": "flight time", "units": "rad"},
}


def threshold_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """Thresholds: dim omega, NaN unless the status is `found`."""
    with _reading("a list of thresholds"):
        variables = {
            field: _variable(field, "omega", _with_nan(answer[field]))
            for field in ("analytic", "up", "down", "predicted_jump", "predicted_down")
        }
        for field in ("up_status", "down_status", "cause", "difference"):
            variables[field] = _variable(field, "omega", answer[field])
        if answer.get("up_computed") is not None:
            variables["up_computed"] = _variable("up_computed", "omega", answer["up_computed"])
        coordinates = {"omega": _variable("omega", "omega", answer["omega"])}
        coordinates["xi"] = _variable("xi", None, answer["xi"])
        dataset = _dataset(variables, coordinates, answer, "bouncing threshold", job_id)
        dataset.attrs["prediction"] = str(answer["prediction"])
        if answer.get("tolerance") is not None:
            dataset.attrs["tolerance"] = float(answer["tolerance"])
        return dataset


def multistability_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """Attractors over a grid: dims (omega, gamma), (omega, gamma, place), (attractor) and (event)."""
    with _reading("multistability"):
        cells = answer["cells"]
        plane = ("omega", "gamma")
        counts = [[-1 if n is None else n for n in line] for line in answer["count"]]
        about = {"long_name": "attractors of the cell", "comment": "-1: not computed", "units": "1"}
        variables: dict[str, Any] = {"count": (plane, np.array(counts, np.int32), about)}
        places = max(len(cell) for line in cells for cell in line)
        _fitting(sum(map(len, cells)), places)
        shape = (len(answer["omega"]), len(answer["gamma"]), places)
        for name, (dtype, empty, attributes) in _PLACES.items():
            found = [
                [place[name] for place in cell] + [empty] * (places - len(cell))
                for line in cells
                for cell in line
            ]
            variables[name] = ((*plane, "place"), np.array(found, dtype).reshape(shape), dict(attributes))
        if any("flight_time" in place for line in cells for cell in line for place in cell):
            flights = _padded(
                [
                    times
                    for line in cells
                    for cell in line
                    for times in [*(place["flight_time"] for place in cell), *[[]] * (places - len(cell))]
                ]
            )
            flights = flights.reshape(*shape, flights.shape[-1])
            variables["flight_time"] = ((*plane, "place", "flight"), flights, _attributes("flight_time"))
        attractors, events = answer["attractors"], answer["events"]
        labels = np.array([attractor["label"] for attractor in attractors], np.str_)
        variables["attractor_label"] = ("attractor", labels, {"long_name": "commonest label"})
        extents = np.array([attractor["cells"] for attractor in attractors], np.int32)
        variables["cells"] = ("attractor", extents, {"long_name": "cells of the attractor", "units": "1"})
        for name, (field, dtype, none) in _EVENTS.items():
            values = [none if event[field] is None else event[field] for event in events]
            variables[name] = ("event", np.array(values, dtype))
        coordinates = {
            **{axis: _variable(axis, axis, answer[axis]) for axis in plane},
            "attractor": ("attractor", np.array([attractor["id"] for attractor in attractors], np.int32)),
            "xi": _variable("xi", None, answer["xi"]),
        }
        dataset = _dataset(variables, coordinates, answer, "attractors over a grid", job_id)
        for name in ("several", "several_by_drops"):
            dataset.attrs[name] = float(_number(answer[name]))
        return dataset


def trajectory_dataset(answer: Mapping[str, Any]) -> xarray.Dataset:
    """The motion of one cell: dims phase (samples) and flight (those that start and end within them)."""
    with _reading("a trajectory"):
        samples = {
            name: ("phase", _sample(name, answer[name]), dict(attributes))
            for name, attributes in _SAMPLES.items()
        }
        flights = {
            name: ("flight", np.array(answer["flights"][name], np.float64), dict(attributes))
            for name, attributes in _FLIGHTS.items()
        }
        phase = np.array(answer["phase"], np.float64)
        coordinates = {
            "phase": ("phase", phase, {"long_name": "plate phase, with whole periods added", "units": "rad"}),
            **{name: ((), float(answer[name])) for name in ("gamma", "omega", "xi")},
        }
        balance = {
            name: _cycle_variable(name, (), value) for name, value in (answer.get("energy") or {}).items()
        }
        attributes = {"rest_length": float(answer["rest_length"]), "complete": int(answer["complete"])}
        return xarray.Dataset({**samples, **flights, **balance}, coordinates, attributes)


def thresholds_dataset(answer: Mapping[str, Any]) -> xarray.Dataset:
    """The thresholds of one spring as scalars, NaN where there is none; `threshold` is infinite then."""
    with _reading("the thresholds of a spring"):
        number = {name: answer[name] for name in ("threshold", "jump", "down")}
        number["threshold"] = np.inf if number["threshold"] is None else number["threshold"]
        lifetime = answer["lifetime"] or {"delta": None, "periods": None}
        number |= {"lifetime": lifetime["periods"], "delta": lifetime["delta"]}
        variables = {name: _cycle_variable(name, (), _number(value)) for name, value in number.items()}
        variables |= {
            name: _cycle_variable(name, (), str(answer[name] or "")) for name in ("cause", "reason")
        }
        for name in _ENERGY:
            variables[name] = _cycle_variable(name, (), _number((answer["energy"] or {}).get(name)))
        coordinates = {name: _variable(name, None, answer[name]) for name in ("omega", "xi")}
        return xarray.Dataset(variables, coordinates, _closed_form("thresholds of a spring"))


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


def _attributes(field: str) -> dict[str, Any]:
    return dict(_RESULTS[field][1])


def _sample(name: str, values: Sequence[Any]) -> NDArray[Any]:
    return np.array(values, np.bool_) if name == "in_flight" else _with_nan(values)


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
