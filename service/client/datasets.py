"""OnDemandCache of the service as xarray Datasets, described as the CF conventions ask."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.params import Outcome
from service.client.errors import UnexpectedAnswer

Attributes: TypeAlias = Mapping[str, Any]
Variable: TypeAlias = tuple[str | tuple[()], NDArray[Any], dict[str, Any]]

_OUTCOMES: Final = {
    "flag_values": np.array([outcome.value for outcome in Outcome], np.uint8),
    "flag_meanings": " ".join(outcome.name.lower() for outcome in Outcome),
}

#: What the numbers are: dtype and attributes of every variable and coordinate.
_VARIABLES: Final[Mapping[str, tuple[type, Attributes]]] = {
    "gamma": (np.float64, {"long_name": "plate acceleration Γ = Aω²/g", "units": "1"}),
    "omega": (np.float64, {"long_name": "plate frequency Ω = ω/ω0", "units": "1"}),
    "xi": (np.float64, {"long_name": "damping ratio ξ of the spring", "units": "1"}),
    "flight_time": (np.float64, {"long_name": "flight time", "units": "rad"}),
    "takeoff_phase": (np.float64, {"long_name": "plate phase at take-off", "units": "rad"}),
    "flights": (np.int32, {"long_name": "flights within the observation window", "units": "1"}),
    "outcome": (np.uint8, {"long_name": "what became of the cell", **_OUTCOMES}),
    "bounces": (np.int16, {"long_name": "bounces of the mode, 0 if none was found", "units": "1"}),
    "periods": (np.int16, {"long_name": "plate periods of the mode, 0 if none was found", "units": "1"}),
    "analytic": (np.float64, {"long_name": "threshold Γ from rest by Eq. 25", "units": "1"}),
    "up": (np.float64, {"long_name": "lowest Γ that bounces, ascending or from rest", "units": "1"}),
    "down": (np.float64, {"long_name": "lowest Γ that bounces, descending", "units": "1"}),
}


def diagram_dataset(answer: Mapping[str, Any], job_id: str, name: str) -> xarray.Dataset:
    """A diagram: dims (the axis it goes along, flight), flights NaN padded to the longest list.

    The fixed parameters are scalar coordinates holding the grid values they snapped to.
    """
    try:
        along = str(answer["along"])
        variables = {
            field: ((along, "flight"), _padded(answer[field]), _attributes(field))
            for field in ("flight_time", "takeoff_phase")
        }
        counts = {field: _variable(field, along, answer[field]) for field in ("flights", "outcome")}
        counts |= {field: _variable(field, along, answer[field]) for field in ("bounces", "periods")}
        coordinates = {along: _variable(along, along, answer["values"])}
        coordinates |= {field: _variable(field, None, value) for field, value in answer["fixed"].items()}
        coordinates["direction"] = _direction(answer)
        return _dataset({**variables, **counts}, coordinates, answer, f"bifurcation diagram: {name}", job_id)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnexpectedAnswer(
            f"the service answered with something that is not a diagram: {error!r}"
        ) from error


def threshold_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """Thresholds over Ω; NaN where the sweep does not hold the answer."""
    try:
        variables = {
            field: _variable(field, "omega", _numbers(answer[field]))
            for field in ("analytic", "up", "down")
            if answer.get(field) is not None
        }
        coordinates = {"omega": _variable("omega", "omega", answer["omega"])}
        coordinates["xi"] = _variable("xi", None, answer["xi"])
        dataset = _dataset(variables, coordinates, answer, "bouncing threshold", job_id)
        if answer.get("tolerance") is not None:
            dataset.attrs["tolerance"] = float(answer["tolerance"])
        return dataset
    except (KeyError, TypeError, ValueError) as error:
        raise UnexpectedAnswer(
            f"the service answered with something that is no threshold: {error!r}"
        ) from error


def modes_dataset(answer: Mapping[str, Any], job_id: str) -> xarray.Dataset:
    """A mode map: dims (omega, gamma)."""
    try:
        plane = ("omega", "gamma")
        variables = {
            field: (plane, *_variable(field, None, answer[field])[1:])
            for field in ("outcome", "bounces", "periods")
        }
        coordinates = {axis: _variable(axis, axis, answer[axis]) for axis in plane}
        coordinates["xi"] = _variable("xi", None, answer["xi"])
        coordinates["direction"] = _direction(answer)
        return _dataset(variables, coordinates, answer, "mode map", job_id)
    except (KeyError, TypeError, ValueError) as error:
        raise UnexpectedAnswer(
            f"the service answered with something that is no mode map: {error!r}"
        ) from error


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
            "complete": int(answer.get("complete", False)),  # NetCDF knows no booleans
        },
    )


def _variable(field: str, dim: str | None, values: object) -> Variable:
    dtype, _ = _VARIABLES[field]
    return (() if dim is None else dim), np.asarray(values, dtype), _attributes(field)


def _direction(answer: Mapping[str, Any]) -> Variable:
    return (), np.array(str(answer["direction"])), {"long_name": "direction of the ramp"}


def _attributes(field: str) -> dict[str, Any]:
    return dict(_VARIABLES[field][1])


def _numbers(values: Sequence[float | None]) -> NDArray[np.float64]:
    """Numbers with NaN where JSON has null."""
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _padded(rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """(n, longest row) with NaN beyond the end of each row."""
    lengths = np.array([len(row) for row in rows], np.intp)
    width = int(lengths.max(initial=0))
    table = np.full((len(rows), width), np.nan)
    table[np.arange(width) < lengths[:, None]] = [flight for row in rows for flight in row]
    return table
