"""Results as xarray Datasets, from the form in which the service sends them. Knows no result by name."""

import json
from collections.abc import Mapping
from math import prod
from typing import Any, Final

import numpy as np
import xarray

from service.client import accessor  # noqa: F401 - registers `dataset.bounce`
from service.client.errors import UnexpectedAnswer

_DTYPES: Final = frozenset({"bool", "str", "uint8", "int32", "int64", "float32", "float64", "complex128"})


def from_binary(body: bytes) -> xarray.Dataset:
    """The Dataset of a line of JSON and the arrays after it. Raises UnexpectedAnswer."""
    end = body.find(b"\n") + 1
    content = memoryview(bytearray(body))[end:]  # a Dataset can be written to
    try:
        document = json.loads(body[:end])
        data, coords = (
            {str(name): _variable(about, content, document["dims"]) for name, about in document[kind].items()}
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


def _variable(about: Mapping[str, Any], content: memoryview, sizes: Mapping[str, int]) -> xarray.Variable:
    data, dtype = about["data"], str(about["dtype"])
    if dtype not in _DTYPES:
        raise ValueError
    if isinstance(data, dict):
        shape, offset = tuple(map(int, data["shape"])), int(data["offset"])
        if min(shape, default=0) < 0 or offset < 0:
            raise ValueError
        values = np.frombuffer(content, dtype, prod(shape), offset).reshape(shape)
    else:
        values = np.array(data, dtype)
    if not values.size:  # JSON tells the length of the first dimension only
        values = values.reshape([sizes[dim] for dim in about["dims"]])
    attrs = {
        name: np.array(x, values.dtype) if isinstance(x, list) else x for name, x in about["attrs"].items()
    }
    return xarray.Variable(about["dims"], values, attrs)
