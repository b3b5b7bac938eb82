"""How a study is stored: dimensions, coordinates, chunks, arrays and attributes.

Each kind of study declares its variables in its package.
"""

import json
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import KERNEL_VERSION, Outcome
from worker.spec.specification import Specification

#: The dimensions that identify a cell, slowest first. A study has some of them.
CELL_DIMS: Final = ("direction", "xi", "omega", "gamma")

#: Name of the array that says which cells were computed, in a study that fills in others.
COMPUTED: Final = "computed"

#: Who computed results, by which kernel version, and the reference of the model.
SOURCE: Final = "bouncing-spring, kernel version {}: numerical solution of the model"
REFERENCE: Final = (
    "Hubert, Ludewig, Dorbolo and Vandewalle, Bouncing dynamics of a spring, Physica D 272 (2014)"
)

#: Attributes that files hold as JSON text, because they can hold only texts and numbers.
_STRUCTURED: Final = ("spec", "choice", "time_steps", "chunk_shape")

_METADATA_KEY: Final = "zarr.json"
_CHUNK_KEY: Final = re.compile(r"c/0|c(?:\.(?:0|[1-9][0-9]{0,8})){1,8}")  # of a coordinate, of an array

#: Chunks of more bytes than this, before compression, are shards of inner chunks of at most INNER_BYTES:
#: reading a cell reads one inner chunk.
WHOLE_BYTES: Final = 512 * 2**10
INNER_BYTES: Final = 128 * 2**10


class Array(NamedTuple):
    """A stored array. `fill` is the value in cells that are not computed."""

    name: str
    dims: tuple[str, ...]
    dtype: str
    fill: float | int
    attrs: dict[str, Any]
    earlier: str | None = None  # its name in stores of earlier releases, if they have another

    def name_in(self, names: Collection[str]) -> str:
        """Its name in a store with arrays of these names, which may be one of an earlier release."""
        return self.earlier if self.earlier is not None and self.earlier in names else self.name

    @property
    def extra_dims(self) -> tuple[str, ...]:
        """The dimensions beside CELL_DIMS; every chunk spans them whole."""
        return tuple(dim for dim in self.dims if dim not in CELL_DIMS)


class Code(NamedTuple):
    """The names along a dimension as numbers with CF flags, for readers of zarr without text."""

    dim: str
    values: NDArray[np.uint8]  # (n,)
    attrs: dict[str, Any]


@dataclass(frozen=True)
class Layout:
    """Dimensions, coordinates, chunks, arrays and attributes of a store.

    Every array has the cell dimensions first; a chunk spans the others whole. The last array, `outcome`, has
    only the cell dimensions. It is written last: a cell without it is missing.
    """

    chunk_sizes: Mapping[str, int]  # cells of a chunk along each cell dimension, slowest first
    coordinates: Mapping[str, NDArray[Any]]  # the values along each cell dimension, (n,)
    extra_sizes: Mapping[str, int]  # length of every other dimension
    arrays: tuple[Array, ...]  # in the order they are written
    coordinate_attrs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)  # of the store
    #: Attributes that identify the store: `job` and `chunk_shape`.
    identity: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def codes(self) -> Mapping[str, Code]:
        """The text coordinates as numbers."""
        return {
            f"{name}_code": _code(name, values, self.coordinate_attrs.get(name, {}))
            for name, values in self.coordinates.items()
            if values.dtype.kind == "T"
        }

    def array_attrs(self, array: Array) -> dict[str, Any]:
        """Attributes of an array, with the codes of its dimensions as auxiliary coordinates."""
        codes = [name for name, code in self.codes.items() if code.dim in array.dims]
        return {**array.attrs, "coordinates": " ".join(codes)} if codes else array.attrs

    @property
    def names(self) -> tuple[str, ...]:
        """The arrays in the order they are written."""
        return tuple(array.name for array in self.arrays)

    def stored_as(self, names: Collection[str]) -> "Layout":
        """The layout of an earlier release's store, which has arrays of these names."""
        arrays = [array._replace(name=array.name_in(names)) for array in self.arrays]
        return replace(self, arrays=tuple(array for array in arrays if array.name in names))

    def shape(self, array: Array) -> tuple[int, ...]:
        """Length of an array along each of its dimensions."""
        lengths = {**self.extra_sizes, **{dim: len(values) for dim, values in self.coordinates.items()}}
        return tuple(lengths[dim] for dim in array.dims)

    def chunk_shape(self, array: Array) -> tuple[int, ...]:
        """Length of an array's chunk along each of its dimensions."""
        return tuple(self.chunk_sizes.get(dim) or self.extra_sizes[dim] for dim in array.dims)

    def inner_shape(self, array: Array) -> tuple[int, ...] | None:
        """Length of an array's inner chunks along each of its dimensions; None if chunks are not sharded.

        Chunks are halved along the cell dimensions in turn, so that reading a line along any of them reads
        few other cells. Odd lengths are not halved.
        """
        size, sizes = self._chunk_bytes(array), dict(self.chunk_sizes)
        if size <= WHOLE_BYTES:
            return None
        while size > INNER_BYTES and (even := [dim for dim, n in sizes.items() if n % 2 == 0]):
            longest = max(even, key=lambda dim: sizes[dim] / self.chunk_sizes[dim])
            sizes[longest] //= 2
            size //= 2
        shape = tuple(sizes.get(dim) or self.extra_sizes[dim] for dim in array.dims)
        return shape if sizes != self.chunk_sizes else None

    @property
    def chunk_bytes(self) -> int:
        """Bytes of one chunk of all arrays, before compression."""
        return sum(map(self._chunk_bytes, self.arrays))

    def _chunk_bytes(self, array: Array) -> int:
        return math.prod(self.chunk_shape(array)) * np.dtype(array.dtype).itemsize

    def coords(self, slices: Sequence[slice]) -> tuple[int, ...]:
        """Coordinates of the chunk that spans these cells, in the grid of chunks."""
        return tuple(span.start // size for span, size in zip(slices, self.chunk_sizes.values(), strict=True))

    def describe(self, slices: Sequence[slice]) -> str:
        """The cells as text, fastest dimension first: `up, gamma 1 to 1.5, omega 0.5, xi 0.26`."""
        spans = {
            dim: _ends(self.coordinates[dim][span])
            for dim, span in zip(self.chunk_sizes, slices, strict=True)
        }
        numbers = [f"{dim} {span}" for dim, span in reversed(spans.items()) if dim != "direction"]
        return ", ".join(([spans["direction"]] if "direction" in spans else []) + numbers)

    def has_key(self, key: str) -> bool:
        """Whether a store with this layout may have a file `key`: metadata, or a chunk of an array."""
        name, _, rest = key.partition("/")
        if name not in self.coordinates and name not in self.codes and name not in self.names:
            return key == _METADATA_KEY
        return rest == _METADATA_KEY or _CHUNK_KEY.fullmatch(rest) is not None


def _code(name: str, values: NDArray[Any], attrs: Mapping[str, Any]) -> Code:
    flags = np.arange(len(values), dtype=np.uint8)
    meaning = {"flag_values": flags.tolist(), "flag_meanings": " ".join(values.tolist())}
    return Code(name, flags, {"long_name": f"{attrs.get('long_name', name)}, as a number", **meaning})


def flat_attributes(attrs: Mapping[str, Any]) -> dict[str, str | int | float]:
    """Attributes as texts and numbers, which every format can hold. Other values become JSON text."""
    return {
        name: value if isinstance(value, str | int | float) else json.dumps(value, ensure_ascii=False)
        for name, value in attrs.items()
    }


def structured_attributes(attrs: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of a store or file, with the values of JSON texts. Other texts stay as they are."""
    parsed = dict(attrs)
    for name in _STRUCTURED:
        if isinstance(value := attrs.get(name), str):
            with suppress(ValueError):
                parsed[name] = json.loads(value)
    return parsed


def _ends(values: NDArray[Any]) -> str:
    first, last = (value if isinstance(value, str) else f"{value:g}" for value in (values[0], values[-1]))
    return first if len(values) == 1 else f"{first} to {last}"


OUTCOME_FLAGS: Final[dict[str, Any]] = {
    "flag_values": [int(outcome) for outcome in Outcome],
    "flag_meanings": " ".join(outcome.name.lower() for outcome in Outcome),
}


def array(
    name: str, dims: tuple[str, ...], dtype: str, long_name: str, units: str | None = "1", **attrs: Any
) -> Array:
    """An array whose fill value is NaN, or zero for integers."""
    about = {"long_name": long_name} if units is None else {"long_name": long_name, "units": units}
    return Array(name, dims, dtype, math.nan if dtype in ("<f8", "<c16") else 0, about | attrs)


def whether_computed(dims: tuple[str, ...], otherwise: str) -> Array:
    """The array `outcome` of a study whose cells have a result, or, with the meaning `otherwise`, none."""
    flags = [Outcome.MISSING.value, Outcome.PERIODIC.value, Outcome.UNRESOLVED.value]
    meanings = f"missing computed {otherwise}"
    return array(
        "outcome", dims, "|u1", "whether the cell is computed", flag_values=flags, flag_meanings=meanings
    )


#: The attributes of the coordinates of cells.
COORDINATES: Final[Mapping[str, dict[str, Any]]] = {
    "direction": {"long_name": "protocol: from rest, or the ramp's direction"},
    "xi": {"long_name": "damping ratio of the spring", "units": "1"},
    "omega": {"long_name": "plate frequency over the spring's natural frequency", "units": "1"},
    "gamma": {"long_name": "plate acceleration over gravity", "units": "1"},
}


def bytes_of(arrays: Iterable[Array], sizes: Mapping[str, int]) -> int:
    """Stored bytes per cell before compression."""
    return sum(np.dtype(a.dtype).itemsize * math.prod(sizes[dim] for dim in a.extra_dims) for a in arrays)


def empty_record(
    shape: tuple[int, ...], arrays: Iterable[Array], sizes: Mapping[str, int]
) -> dict[str, NDArray[Any]]:
    """The arrays of a chunk of `shape` cells with their fill values."""
    return {a.name: np.full((*shape, *(sizes[dim] for dim in a.extra_dims)), a.fill, a.dtype) for a in arrays}


def grid_layout(
    spec: Specification, chunk_shape: tuple[int, ...], arrays: tuple[Array, ...], sizes: Mapping[str, int],
    coordinates: Mapping[str, tuple[NDArray[Any], dict[str, Any]]], title: str, model: str,
    slowest: Mapping[str, NDArray[Any]] | None = None,
) -> Layout:  # fmt: skip
    """Layout of a store over the axes of a specification, with chunks of `chunk_shape` cells.

    coordinates: values and attributes of other dimensions. slowest: values along cell dimensions before the
    axes, where chunks have length one.
    """
    before = slowest or {}
    axes = {**before, **{axis: spec.axis_values(axis).astype("<f8") for axis in spec.AXES}}
    attrs = {name: about for name, about in COORDINATES.items() if name in axes}
    return Layout(
        chunk_sizes=dict(zip(axes, (1,) * len(before) + chunk_shape, strict=True)),
        coordinates=axes | {name: values for name, (values, _) in coordinates.items()},
        extra_sizes=sizes,
        arrays=arrays,
        coordinate_attrs=attrs | {name: about for name, (_, about) in coordinates.items()},
        attributes={  # depend only on the specification
            "Conventions": "CF-1.11",
            "title": spec.name or title,
            "source": SOURCE.format(KERNEL_VERSION),
            "references": REFERENCE,
            "kernel_version": KERNEL_VERSION,
            "model": model,
            "spec": spec.as_submitted(),
        },
        identity={"job": spec.job_id(KERNEL_VERSION), "chunk_shape": list(chunk_shape)},
    )
