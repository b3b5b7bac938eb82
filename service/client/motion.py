"""The motion of one cell, as an xarray Dataset."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import xarray

from service.client.errors import UnexpectedAnswer

_LENGTH: Final = {"units": "plate amplitudes"}
_SAMPLED: Final[Mapping[str, Mapping[str, str]]] = {
    "plate": {"long_name": "plate", **_LENGTH},
    "z1": {"long_name": "upper mass", **_LENGTH},
    "z2": {"long_name": "lower mass", **_LENGTH},
    "force": {"long_name": "force of the plate on the lower mass", "units": "m A ω²"},
    "in_flight": {"long_name": "whether the spring is off the plate"},
}
_PER_FLIGHT: Final[Mapping[str, Mapping[str, str]]] = {
    "takeoff": {"long_name": "phase of take-off since the first sample", "units": "rad"},
    "takeoff_phase": {"long_name": "plate phase at take-off", "units": "rad"},
    "flight_time": {"long_name": "flight time", "units": "rad"},
}


def motion_dataset(answer: Mapping[str, Any]) -> xarray.Dataset:
    """Dims phase (the samples) and flight (those that took off and landed within them)."""
    try:
        sampled = {
            name: ("phase", _array(name, answer[name]), dict(about)) for name, about in _SAMPLED.items()
        }
        flights = {
            name: ("flight", np.array(answer["flights"][name], np.float64), dict(about))
            for name, about in _PER_FLIGHT.items()
        }
        phase = np.array(answer["phase"], np.float64)
        coordinates = {
            "phase": ("phase", phase, {"long_name": "plate phase since the first sample", "units": "rad"}),
            **{name: ((), float(answer[name])) for name in ("gamma", "omega", "xi")},
        }
        attributes = {"rest_length": float(answer["rest_length"]), "complete": int(answer["complete"])}
        return xarray.Dataset({**sampled, **flights}, coordinates, attributes)
    except (KeyError, TypeError, ValueError) as error:
        raise UnexpectedAnswer(
            f"the service answered with something that is not a trajectory: {error!r}"
        ) from error


def _array(name: str, values: list[Any]) -> np.ndarray[Any, Any]:
    if name == "in_flight":
        return np.array(values, np.bool_)
    return np.array([np.nan if value is None else value for value in values], np.float64)
