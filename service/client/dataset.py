"""Results as xarray Datasets, from the two forms in which the service sends them. Knows no result by name."""

import json
from collections.abc import Callable, Mapping
from math import prod
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from service.client import accessor  # noqa: F401 - registers `dataset.bounce`
from service.client.errors import UnexpectedAnswer

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

_DTYPES: Final = frozenset({"bool", "str", "uint8", "int32", "int64", "float32", "float64", "complex128"})


def from_json(body: bytes) -> xarray.Dataset:
    """The Dataset of a JSON document; null is NaN. Raises UnexpectedAnswer."""

    def values(variable: Mapping[str, Any]) -> NDArray[Any]:
        return np.array(variable["data"], _dtype(variable))

    return _read(body, values)


def from_binary(body: bytes) -> xarray.Dataset:
    """The Dataset of a line of JSON and the arrays after it. Raises UnexpectedAnswer."""
    end = body.find(b"\n") + 1
    content = bytearray(body)  # a Dataset can be written to

    def values(variable: Mapping[str, Any]) -> NDArray[Any]:
        data, dtype = variable["data"], _dtype(variable)
        if not isinstance(data, dict):
            return np.array(data, dtype)
        shape, offset = tuple(map(int, data["shape"])), int(data["offset"])
        if min(shape, default=0) < 0 or offset < 0:
            raise ValueError
        return np.frombuffer(content, dtype, prod(shape), end + offset).reshape(shape)

    return _read(body[:end], values)


def _dtype(variable: Mapping[str, Any]) -> "DTypeLike":
    name = variable["dtype"]
    if name not in _DTYPES:
        raise ValueError
    return str(name)


def _read(header: bytes, values: Callable[[Mapping[str, Any]], NDArray[Any]]) -> xarray.Dataset:
    try:
        document = json.loads(header)
        data, coords = (
            {
                str(name): _variable(about, values(about), document["dims"])
                for name, about in document[kind].items()
            }
            for kind in ("data_vars", "coords")
        )
        # NetCDF has neither booleans nor null: the Dataset can be written as it is.
        attrs = {
            name: int(x) if isinstance(x, bool) else np.nan if x is None else x
            for name, x in document["attrs"].items()
        }
        return xarray.Dataset(data, coords, attrs)
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError) as error:
        raise UnexpectedAnswer(
            "the answer is not a result: not a bounce service, or of another release"
        ) from error


def _variable(about: Mapping[str, Any], values: NDArray[Any], sizes: Mapping[str, int]) -> xarray.Variable:
    if not values.size:  # JSON tells the length of the first dimension only
        values = values.reshape([sizes[dim] for dim in about["dims"]])
    attrs = {
        name: np.array(x, values.dtype) if isinstance(x, list) else x for name, x in about["attrs"].items()
    }
    return xarray.Variable(about["dims"], values, attrs)
