"""Selects and reads cells of a stored study: grid indices, directions, thinning, and which flights count.

Flights up to `min_flight` do not count, unless a cell has no longer ones. The default is the `micro_flight`
with which the sweep was classified. For another value, outcome and mode are found anew from the stored
flights.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernel.labels import LABELS, UNSTABLE, label_codes
from kernel.modes import Modes, recount
from kernel.params import KERNEL_VERSION, Outcome
from service.errors import InvalidRequest, OutdatedJob
from service.pictures import CLASS_NAMES, classes_of
from service.software import software
from worker import store
from worker.spec.errors import one_of
from worker.spec.specification import Specification
from worker.studies import study_of
from worker.study import Array, Layout
from worker.study.layout import CELL_DIMS, COMPUTED
from worker.sweep import AXES, SweepSpec, schema
from worker.sweep.schema import MODE_ARRAYS

#: Limit on the flights, or outcomes, held in memory for a picture or a summary; longer lines are thinned.
MAX_READ: Final = 8_000_000

#: Bytes of memory for reading, beside the arrays of the answer: whole chunks of which a part is kept.
BASE_MEMORY: Final = 16 * 2**20

#: Tolerance at the ends of an axis, relative to the larger end.
ROUNDING: Final = 1e-9

#: Indices by cell dimension: an integer drops the dimension, a slice keeps it.
Indices = Mapping[str, int | slice]
Arrays = Mapping[str, NDArray[Any]]

_Spec_co = TypeVar("_Spec_co", bound=Specification, covariant=True)

#: The variable that answers have beside the stored arrays, if exponents are stored.
LABEL: Final = Array(
    "label", CELL_DIMS, "|u1", 0,
    {
        "long_name": "outcome, with aperiodic and unstable cells told apart by Lyapunov exponents",
        "units": "1",
        "flag_values": list(range(len(LABELS))),
        "flag_meanings": " ".join(LABELS),
        "comment": "of skipped cells of an adaptive map that of a computed neighbour",
    },
)  # fmt: skip

#: The variables of a cell's mode, and its label.
MODES: Final = (*(row for row in schema.RECORD if row.name in MODE_ARRAYS), schema.OUTCOME, LABEL)


@dataclass(frozen=True)
class Stored(Generic[_Spec_co]):
    """The specification of a job's study as it is computed, and the address of its store."""

    spec: _Spec_co
    url: str
    complete: bool = False  # the job is done: a missing chunk is damage, not work to come
    kernel_version: str = KERNEL_VERSION  # that computed the job
    repairing: bool = False  # damage was found: no answer is complete until the job is done again
    job: str | None = None  # id of the job
    chunks_done: int = 0
    #: Forms of the stored arrays; None for another kernel version, whose forms only the store knows.
    forms: Mapping[str, store.ArrayForm] | None = None
    submitted: Any = None  # the specification as submitted, perhaps with the contact `auto`
    audit: str | None = None  # sentence of the last audit, for files and pictures
    other: "Stored[Any] | None" = None  # the study to compare with

    def is_complete(self, outcome: NDArray[np.uint8]) -> bool:
        """Whether all these cells are computed, and no damage is being repaired."""
        return not self.repairing and bool(np.all(outcome != Outcome.MISSING))

    @property
    def begun(self) -> bool:
        """Whether a chunk is done: a missing store is damage then, not work to come."""
        return self.complete or self.chunks_done > 0

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of files and pictures: job, audit, versions, and a comment on another kernel version."""
        job = {} if self.job is None else {"job": self.job}
        if self.audit is not None:
            job["audit"] = self.audit
        attributes = {**job, "kernel_version": self.kernel_version, "release": software().release}
        if self.kernel_version != KERNEL_VERSION:
            attributes["comment"] = (
                f"computed by kernel version {self.kernel_version}; "
                f"the release that wrote this file computes version {KERNEL_VERSION}"
            )
        return attributes

    @property
    def origin(self) -> dict[str, str]:
        """The attributes, and as JSON the specification that the job's id is of."""
        spec = self.submitted or self.spec
        return {**self.attributes, "spec": json.dumps(spec.as_submitted(), ensure_ascii=False)}


def check_kernel(study: Stored[Any]) -> None:
    """Raise OutdatedJob for cells of another kernel version, which this release would continue."""
    if study.kernel_version != KERNEL_VERSION:
        raise OutdatedJob(
            f"the sweep was computed by kernel version {study.kernel_version}; this release computes version "
            f"{KERNEL_VERSION}: submit the sweep again, or read what is stored"
        )


@dataclass(frozen=True, slots=True)
class GridValue:
    """A value of a grid axis and its index."""

    index: int
    value: float


def nearest_index(spec: Specification, axis: str, value: float | None, whose: str = "the sweep") -> GridValue:
    """The grid value nearest to `value`; None selects the value of an axis with only one.

    Raises InvalidRequest for a value outside the axis, and for None if the axis has several values.
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
        raise InvalidRequest.of(axis, f"must be within {whose}, which is {extent}, not {value!r}")
    index = int(np.argmin(np.abs(values - value)))
    return GridValue(index, float(values[index]))


def nearest_values(spec: Specification, query: Any, axes: Iterable[str]) -> dict[str, GridValue]:
    """The grid values nearest to the fields of a query, by axis. Raises InvalidRequest as `nearest_index`."""
    return {axis: nearest_index(spec, axis, getattr(query, axis)) for axis in axes}


def fixed_axes(spec: SweepSpec, query: Any) -> dict[str, GridValue]:
    """The grid values of all axes but `query.along`. Raises InvalidRequest, also for a value of that axis."""
    if getattr(query, query.along) is not None:
        rule = "is the axis that varies: leave it out, or name another with along"
        raise InvalidRequest.of(query.along, rule)
    return nearest_values(spec, query, (axis for axis in reversed(AXES) if axis != query.along))


def directions_of(spec: SweepSpec, direction: str | None) -> tuple[str, ...]:
    """`direction`, or all directions of the sweep if None. Raises InvalidRequest if the sweep lacks it."""
    if direction is None:
        return tuple(spec.directions)
    if direction not in spec.directions:
        raise InvalidRequest.of("direction", f"must be {one_of(spec.directions)} in this sweep")
    return (direction,)


def check_order(query: Any, lower: str, upper: str, *, wide: bool = False) -> None:
    """Raise InvalidRequest if one end of a window is above the other; of a `wide` one, also if both agree."""
    start, stop = getattr(query, lower), getattr(query, upper)
    if start is not None and stop is not None and (start >= stop if wide else start > stop):
        rule = f"must {'be below' if wide else 'not be above'} {upper}, which is {stop:g}"
        raise InvalidRequest.of(lower, rule)


def between(values: NDArray[np.float64], query: Any, lower: str, upper: str) -> range:
    """Indices of the values within the window of a query; if there are none, of the nearest value.

    lower, upper: fields of the query; None stands for an end of the axis. Raises InvalidRequest for a window
    with swapped ends, or outside the axis.
    """
    check_order(query, lower, upper)
    start, stop, ends = getattr(query, lower), getattr(query, upper), (float(values[0]), float(values[-1]))
    first, last = ends[0] if start is None else start, ends[1] if stop is None else stop
    first, last = first * (1.0 - 1e-12), last * (1.0 + 1e-12)  # 0.8 of a grid may be 0.7999999999999999
    if first > ends[1]:
        raise InvalidRequest.of(lower, f"must not be above the axis, which ends at {ends[1]:g}")
    if last < ends[0]:
        raise InvalidRequest.of(upper, f"must not be below the axis, which begins at {ends[0]:g}")
    low = int(np.searchsorted(values, first, side="left"))
    high = int(np.searchsorted(values, last, side="right"))
    nearest = int(np.argmin(np.abs(values - 0.5 * (first + last))))
    return range(low, high) if low < high else range(nearest, nearest + 1)


def read_stored(
    study: Stored[Specification], names: Sequence[str], indices: Indices
) -> dict[str, NDArray[Any]]:
    """The named arrays of a study at `indices`, whole along all other dimensions.

    Cells that are not computed, and variables that another kernel version did not store, hold fill values.
    Raises a `store.StoreError`.
    """
    try:
        stored = {name: name for name in names}
        if study.forms is None:
            forms = store.stored_forms(study.url, None)
            stored = {array.name: array.name_in(forms) for array in _layout(study.spec).arrays}
            stored = {name: stored[name] for name in names if stored[name] in forms}
        values = store.read_slice(
            study.url, stored.values(), **indices, complete=study.complete, forms=study.forms
        )
        arrays = {name: values[there] for name, there in stored.items()}
    except store.StoreMissing as error:
        if study.begun:
            raise store.StoreDamaged(str(error)) from error
        arrays = {}  # the store is created with the first chunk
    return arrays if len(arrays) == len(names) else _fill_values(study.spec, names, indices) | arrays


def _layout(spec: Any) -> Layout:
    """The layout of a study's store, whatever its chunks."""
    return study_of(spec).variables(spec, (1,) * len(spec.AXES))


def _fill_values(spec: Any, names: Sequence[str], indices: Indices) -> dict[str, NDArray[Any]]:
    """The named arrays as they are before any cell is computed."""
    layout, values = _layout(spec), {}
    for array in layout.arrays:
        if array.name in names:
            lengths = zip(array.dims, layout.shape(array), strict=True)
            parts = [range(length)[indices.get(dim, slice(None))] for dim, length in lengths]
            shape = [len(part) for part in parts if isinstance(part, range)]
            values[array.name] = np.full(shape, array.fill, array.dtype)
    return values


def read_direction(
    study: Stored[SweepSpec], names: Sequence[str], direction: str, indices: Indices
) -> dict[str, NDArray[Any]]:
    """The named arrays of a sweep in one direction, as `read_stored`."""
    return read_stored(study, names, {"direction": study.spec.directions.index(direction), **indices})


def shortest(spec: SweepSpec, min_flight: float | None) -> float:
    """The limit above which flights count, rad: `min_flight`, or the sweep's own."""
    return spec.micro_flight if min_flight is None else min_flight


def needs_flights(spec: SweepSpec, min_flight: float | None) -> bool:
    """Whether outcome and mode must be found anew from the stored flights."""
    return shortest(spec, min_flight) != spec.micro_flight


def arrays_of_modes(spec: SweepSpec, min_flight: float | None) -> tuple[str, ...]:
    """The stored arrays that `recounted` needs."""
    flights = ("flight_time", "takeoff_phase", "flights") if needs_flights(spec, min_flight) else ()
    exponents = (schema.LYAPUNOV.name, schema.LYAPUNOV_ERROR.name) if spec.exponents else ()
    return (*flights, *MODE_ARRAYS, *exponents, *((COMPUTED,) if spec.fills_in else ()))


def hidden_cells(
    arrays: Mapping[str, NDArray[Any]], hide: str, multiplier: NDArray[np.float64] | None = None
) -> NDArray[np.bool_]:
    """Which cells belong to the classes in `hide`, separated by commas."""
    classes = classes_of(arrays, multiplier)
    return np.isin(classes, [CLASS_NAMES.index(name) for name in hide.split(",")])


def recounted(spec: SweepSpec, arrays: Arrays, min_flight: float | None) -> dict[str, NDArray[Any]]:
    """The MODE_ARRAYS if flights longer than `min_flight`, rad, count, and the `labelled` arrays.

    In an adaptive map also `computed`: cells that are filled in have no flights, and keep their mode. arrays:
    at least `arrays_of_modes`, of any cells.
    """
    modes = {name: arrays[name] for name in MODE_ARRAYS}
    if needs_flights(spec, min_flight):
        times, phases = (
            np.ascontiguousarray(arrays[name]).reshape(-1, spec.keep)
            for name in ("flight_time", "takeoff_phase")
        )
        stored = Modes(*(arrays[name].ravel() for name in MODE_ARRAYS))
        counted = recount(
            times, phases, arrays["flights"].ravel(), stored, spec.micro_flight, shortest(spec, min_flight)
        )
        modes = {name: getattr(counted, name).reshape(arrays["flights"].shape) for name in MODE_ARRAYS}
    computed = {COMPUTED: arrays[COMPUTED]} if spec.fills_in else {}
    return modes | labelled(spec, modes[schema.OUTCOME.name], {**arrays, **modes}) | computed


def filled_in(arrays: Arrays, name: str) -> NDArray[Any]:
    """An array of a line or of planes; cells that are filled in have the value of the nearest computed cell.

    Steps lead to it from cell to cell of the same mode.
    """
    framed = [np.pad(np.atleast_2d(arrays[x].squeeze()), 1) for x in (*MODE_ARRAYS, COMPUTED, name)]
    cells = np.arange(framed[0].size).reshape(framed[0].shape)[(slice(1, -1),) * framed[0].ndim]
    row, (*modes, known, values) = framed[0].shape[-1], (x.ravel() for x in framed)
    waiting, before = cells[known[cells] == 0], -1  # nothing is known of the frame
    while before != len(waiting):
        before = len(waiting)
        for step in (1, -1, row, -row):
            near = waiting + step
            takes = np.logical_and.reduce([known[near] == 1, *(x[near] == x[waiting] for x in modes)])
            values[waiting[takes]] = values[near[takes]]
            known[waiting[takes]] = 1
            waiting = waiting[~takes]
    return values[cells].reshape(arrays[name].shape)


def labelled(spec: SweepSpec, outcome: NDArray[np.uint8], arrays: Arrays) -> dict[str, NDArray[Any]]:
    """The LABEL of cells and the exponents that decide it, by name; empty if no exponents are stored."""
    if not spec.exponents:
        return {}
    lyapunov, error = arrays[schema.LYAPUNOV.name], arrays[schema.LYAPUNOV_ERROR.name]
    label = label_codes(outcome, lyapunov, error, spec.observe)
    if spec.fills_in:
        label = filled_in({**arrays, LABEL.name: label}, LABEL.name)
    return {LABEL.name: label, schema.LYAPUNOV.name: lyapunov, schema.LYAPUNOV_ERROR.name: error}


def attractor_label(code: int, bounces: int, periods: int) -> str:
    """`rest`, a mode such as `(3,4)`, or the label of an aperiodic attractor; code: an outcome or label."""
    if code in (Outcome.PERIODIC, UNSTABLE):
        return f"({bounces},{periods})" + (" unstable" if code == UNSTABLE else "")
    return "rest" if code == Outcome.AT_REST else LABELS[code]
