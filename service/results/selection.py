"""Selects cells of a stored sweep: grid indices, direction, thinning, the limit of points, and the read.

The other modules of this package say which cells belong to a diagram, a mode map or a threshold; all of
them select and read the cells here.
"""

import json
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernel.params import KERNEL_VERSION, Outcome
from service.errors import InvalidRequest, OutdatedJob, TooLarge
from service.software import software
from worker import schema, store
from worker.spec import AXES, SweepSpec
from worker.spec.errors import one_of
from worker.spec.specification import Specification

#: Flights, or outcomes, held in memory for one picture or one summary; longer lines are thinned.
MAX_READ: Final = 8_000_000

#: Bytes of memory that reading takes beside the arrays of the answer: chunks, before a part of them is kept.
BASE_MEMORY: Final = 16 * 2**20

#: Rounding that is forgiven at the ends of an axis, relative to the larger of its two ends.
ROUNDING: Final = 1e-9

#: Grid indices by axis: an integer drops the axis, a slice keeps it.
Indices = Mapping[str, int | slice]


_Spec_co = TypeVar("_Spec_co", bound=Specification, covariant=True)


@dataclass(frozen=True)
class Stored(Generic[_Spec_co]):
    """The specification of a job's study as it is computed, and the address of its store."""

    spec: _Spec_co
    url: str
    complete: bool = False  # the job is done: a missing chunk is damage, not work to come
    kernel_version: str = KERNEL_VERSION  # that computed it
    repairing: bool = False  # damage was found: no answer is complete until the job is done again
    job: str | None = None  # its id
    chunks_done: int = 0
    #: How its arrays are stored; None of another kernel version, whose store alone knows.
    forms: Mapping[str, store.ArrayForm] | None = None

    def is_complete(self, outcome: NDArray[np.uint8]) -> bool:
        """Whether all these cells are computed, and no damage is being repaired."""
        return not self.repairing and bool(np.all(outcome != Outcome.MISSING))

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of a picture of these results: job and versions, a comment if the kernel is not ours."""
        job = {} if self.job is None else {"job": self.job}
        attributes = {**job, "kernel_version": self.kernel_version, "release": software().release}
        if self.kernel_version != KERNEL_VERSION:
            attributes["comment"] = (
                f"computed by kernel version {self.kernel_version}; "
                f"the release that wrote this file computes version {KERNEL_VERSION}"
            )
        return attributes

    @property
    def origin(self) -> dict[str, str]:
        """The attributes and the specification, as JSON."""
        return {**self.attributes, "spec": json.dumps(self.spec.as_submitted(), ensure_ascii=False)}


class Sweep(Stored[SweepSpec]):
    """A sweep."""


def check_kernel(version: str) -> None:
    """Raise OutdatedJob if `version` computed cells that this release would continue with its own kernel."""
    if version != KERNEL_VERSION:
        raise OutdatedJob(
            f"the sweep was computed by kernel version {version}; this release computes version "
            f"{KERNEL_VERSION}: submit the sweep again, or read what is stored"
        )


@dataclass(frozen=True, slots=True)
class GridValue:
    """A value of a grid axis and its index."""

    index: int
    value: float


def nearest_index(spec: Specification, axis: str, value: float | None) -> GridValue:
    """The grid value nearest to `value`; None selects the value of an axis that has only one.

    Raises InvalidRequest for a value outside the axis, and for None where the axis has several values.
    """
    values = spec.axis_values(axis)
    low, high = float(values[0]), float(values[-1])
    if value is None:
        if len(values) > 1:
            rule = f"is required: the sweep has {len(values):,} values from {low:g} to {high:g}"
            raise InvalidRequest.of(axis, rule)
        return GridValue(0, low)
    slack = ROUNDING * max(abs(low), abs(high))
    if not low - slack <= value <= high + slack:
        extent = f"from {low!r} to {high!r}" if len(values) > 1 else f"at {low!r} alone"
        raise InvalidRequest.of(axis, f"must be within the sweep, which is {extent}, not {value!r}")
    index = int(np.argmin(np.abs(values - value)))
    return GridValue(index, float(values[index]))


def fixed_axes(spec: SweepSpec, along: str, values: Mapping[str, float | None]) -> dict[str, GridValue]:
    """The grid values of all axes but `along`. Raises InvalidRequest, also for a value of `along`."""
    if values.get(along) is not None:
        raise InvalidRequest.of(along, "is the axis the diagram goes along; leave it out")
    return {axis: nearest_index(spec, axis, values.get(axis)) for axis in reversed(AXES) if axis != along}


def resolve_direction(spec: SweepSpec, direction: str | None) -> str:
    """`direction`, or the sweep's first if None. Raises InvalidRequest for one that the sweep lacks."""
    if direction is None:
        return spec.directions[0]
    if direction not in spec.directions:
        raise InvalidRequest.of("direction", f"must be {one_of(spec.directions)} in this sweep")
    return direction


def directions_of(spec: SweepSpec, direction: str | None) -> tuple[str, ...]:
    """`direction` alone, or all of the sweep if None. Raises InvalidRequest for one that the sweep lacks."""
    return tuple(spec.directions) if direction is None else (resolve_direction(spec, direction),)


def between(values: NDArray[np.float64], start: float | None, stop: float | None) -> range:
    """Indices of the values between two, None being the end; if there are none, the one nearest."""
    first, last = float(values[0]) if start is None else start, float(values[-1]) if stop is None else stop
    low = int(np.searchsorted(values, first, side="left"))
    high = int(np.searchsorted(values, last, side="right"))
    nearest = int(np.argmin(np.abs(values - 0.5 * (first + last))))
    return range(low, high) if low < high else range(nearest, nearest + 1)


def thinning(lengths: Sequence[int], points_per_cell: int, max_points: int) -> int | None:
    """The smallest n for which every n-th cell along all the axes gives at most `max_points` points.

    None if a single cell has more.
    """
    steps = range(1, max(lengths) + 1)
    first = bisect_left(
        steps, True, key=lambda every: points_per_cell * prod(-(-n // every) for n in lengths) <= max_points
    )
    return steps[first] if first < len(steps) else None


def check_points(points: int, max_points: int, what: str, every: int | None) -> None:
    """Raise TooLarge for more points than one answer may hold; `every` is the thinning that fits."""
    if points > max_points:
        hint = "open the store itself, which has no such limit"
        if every is not None:
            hint = f"every={every} fits; request a picture for all of them, or {hint}"
        raise TooLarge(
            f"the answer would hold up to {points:,} points ({what}); the limit is {max_points:,}: {hint}"
        )


def read(
    sweep: Stored[SweepSpec], names: Sequence[str], direction: str, indices: Indices
) -> dict[str, NDArray[Any]]:
    """The named arrays in one direction at `indices`, whole along the axes not named there.

    Cells that are not computed yet hold fill values. Raises a `store.StoreError`.
    """
    selected = {"direction": sweep.spec.directions.index(direction), **indices}
    return read_stored(sweep, names, selected, lambda: _fill_values(sweep.spec, names, selected))


def read_stored(
    study: Stored[Specification],
    names: Sequence[str],
    indices: Indices,
    empty: Callable[[], dict[str, NDArray[Any]]],
) -> dict[str, NDArray[Any]]:
    """The named arrays of any study at `indices`; `empty` makes what they hold before there is a store.

    Variables that an earlier kernel did not store hold the same. Raises a `store.StoreError`.
    """
    try:
        stored = names
        if study.forms is None:
            there = store.stored_forms(study.url, None)
            stored = [name for name in names if name in there]
        found = store.read_slice(study.url, stored, **indices, complete=study.complete, forms=study.forms)
        return found if len(stored) == len(names) else empty() | found
    except store.StoreMissing as error:
        if study.complete:
            raise store.StoreDamaged(str(error)) from error
        # The job is still queued: its store is created with the first chunk.
        return empty()


def check_metadata(study: Stored[Specification]) -> None:
    """Raise a `store.StoreError` unless what a worker is to read is laid out as the specification says."""
    store.stored_forms(study.url, study.forms)


def _fill_values(spec: SweepSpec, names: Sequence[str], selected: Indices) -> dict[str, NDArray[Any]]:
    """What the named arrays hold before any cell is computed."""
    sizes = schema.sizes(spec)
    cells = {dim: range(sizes[dim])[selected.get(dim, slice(None))] for dim in schema.CELL_DIMS}
    shape = [len(part) for part in cells.values() if isinstance(part, range)]
    return {
        array.name: np.full([*shape, *(sizes[dim] for dim in array.extra_dims)], array.fill, array.dtype)
        for array in schema.arrays(spec)
        if array.name in names
    }
