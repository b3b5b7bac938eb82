"""The service's answers as xarray Datasets with CF attributes.

Every function raises UnexpectedAnswer for an answer of another form.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, TypeAlias

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.labels import LABELS
from kernel.params import Outcome
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
    "label": (np.uint8, {"long_name": "outcome, aperiodic cells told apart by lyapunov", **_LABELS}),
    "lyapunov": (
        np.float64,
        {
            "long_name": "Lyapunov exponents, the largest first",
            "units": "1",
            "comment": "per plate period, natural logarithm",
        },
    ),
    "analytic": (np.float64, {"long_name": "threshold Γ from rest by Eq. 25", "units": "1"}),
    "up": (np.float64, {"long_name": "lowest Γ that bounces, ascending or from rest", "units": "1"}),
    "down": (np.float64, {"long_name": "lowest Γ that bounces, descending", "units": "1"}),
    "up_status": (np.str_, {"long_name": "why up is a number or NaN"}),
    "down_status": (np.str_, {"long_name": "why down is a number or NaN"}),
}

_LENGTH: Final = {"units": "plate amplitudes"}

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
    "takeoff": {"long_name": "phase of take-off since the first sample", "units": "rad"},
    "takeoff_phase": {"long_name": "plate phase at take-off", "units": "rad"},
    "flight_time": {"long_name": "flight time", "units": "rad"},
}


def diagram_dataset(answer: Mapping[str, Any], job_id: str, name: str) -> xarray.Dataset:
    """A diagram: dims (its axis, flight), NaN after the last flight of a cell.

    The fixed parameters are scalar coordinates with their grid values.
    """
    with _reading("a diagram"):
        along = str(answer["along"])
        variables = {
            field: ((along, "flight"), _padded(answer[field]), _attributes(field))
            for field in ("flight_time", "takeoff_phase")
        }
        counts = {
            field: _variable(field, along, answer[field])
            for field in ("flights", "outcome", "bounces", "periods", "label")
            if field in answer
        }
        if "lyapunov" in answer:
            exponents = np.array([_with_nan(row) for row in answer["lyapunov"]])
            counts["lyapunov"] = _variable("lyapunov", (along, "exponent"), exponents)
        coordinates = {along: _variable(along, along, answer["values"])}
        coordinates |= {field: _variable(field, None, value) for field, value in answer["fixed"].items()}
        coordinates["direction"] = _direction(answer)
        dataset = _dataset(
            {**variables, **counts}, coordinates, answer, f"bifurcation diagram: {name}", job_id
        )
        dataset.attrs["min_flight"] = float(answer["min_flight"])
        return dataset


def threshold_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """Thresholds: dim omega, NaN unless the status is `found`."""
    with _reading("a list of thresholds"):
        variables = {
            field: _variable(field, "omega", _with_nan(answer[field])) for field in ("analytic", "up", "down")
        }
        for field in ("up_status", "down_status"):
            variables[field] = _variable(field, "omega", answer[field])
        coordinates = {"omega": _variable("omega", "omega", answer["omega"])}
        coordinates["xi"] = _variable("xi", None, answer["xi"])
        dataset = _dataset(variables, coordinates, answer, "bouncing threshold", job_id)
        if answer.get("tolerance") is not None:
            dataset.attrs["tolerance"] = float(answer["tolerance"])
        return dataset


def modes_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """A mode map: dims (omega, gamma)."""
    with _reading("a mode map"):
        plane = ("omega", "gamma")
        variables = {
            field: _variable(field, plane, answer[field])
            for field in ("outcome", "bounces", "periods", "label")
            if answer.get(field) is not None
        }
        coordinates = {axis: _variable(axis, axis, answer[axis]) for axis in plane}
        coordinates["xi"] = _variable("xi", None, answer["xi"])
        coordinates["direction"] = _direction(answer)
        dataset = _dataset(variables, coordinates, answer, "mode map", job_id)
        dataset.attrs["min_flight"] = float(answer["min_flight"])
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
            "phase": ("phase", phase, {"long_name": "plate phase since the first sample", "units": "rad"}),
            **{name: ((), float(answer[name])) for name in ("gamma", "omega", "xi")},
        }
        attributes = {"rest_length": float(answer["rest_length"]), "complete": int(answer["complete"])}
        return xarray.Dataset({**samples, **flights}, coordinates, attributes)


@contextmanager
def _reading(kind: str) -> Iterator[None]:
    """Turn the errors of reading an answer of another form into UnexpectedAnswer."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError) as error:
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
            "complete": int(answer.get("complete", False)),  # NetCDF has no booleans
        },
    )


def _variable(field: str, dim: str | tuple[str, ...] | None, values: object) -> Variable:
    dtype, _ = _RESULTS[field]
    return (() if dim is None else dim), np.asarray(values, dtype), _attributes(field)


def _direction(answer: Mapping[str, Any]) -> Variable:
    return (), np.array(str(answer["direction"])), {"long_name": "direction of the ramp"}


def _attributes(field: str) -> dict[str, Any]:
    return dict(_RESULTS[field][1])


def _sample(name: str, values: Sequence[Any]) -> NDArray[Any]:
    return np.array(values, np.bool_) if name == "in_flight" else _with_nan(values)


def _with_nan(values: Sequence[float | None]) -> NDArray[np.float64]:
    """The numbers, NaN in place of null."""
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _padded(rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """(n, length of the longest row), NaN after the end of each row."""
    lengths = np.array([len(row) for row in rows], np.intp)
    width = int(lengths.max(initial=0))
    table = np.full((len(rows), width), np.nan)
    table[np.arange(width) < lengths[:, None]] = [flight for row in rows for flight in row]
    return table
