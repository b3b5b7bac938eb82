"""The study `orbits`: cycles in closed form on a grid of springs, and the events on their branches.

For the rigid contact without restitution. A cell is a spring, one (xi, omega). Its branches are the modes in
the specification, each with the same number of points in all cells.
"""

import math
import re
import time
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from kernel.branches.events import POINTS as GRID
from kernel.branches.events import Branch, Events, Kind, branch_and_events
from kernel.params import KernelInputError, Outcome
from worker.cost import Cost
from worker.plan import LONGEST_SECONDS, MAX_CHUNK_BYTES, TARGET_SECONDS, Chunk, Plan, even
from worker.schema import Array, Layout, array, bytes_of, empty_record, grid_layout, whether_computed
from worker.spec import LARGEST, SMALLEST
from worker.spec.axes import NUMBER, WHOLE, Axis, Strict, within
from worker.spec.errors import BrokenRuleError, describe
from worker.spec.specification import Specification
from worker.tasks import ChunkReport, Work

#: Maximum modes of a specification or an answer, and maximum plate periods of a mode.
MAX_MODES: Final = 6
MAX_PERIODS: Final = 12

#: Maximum flight times per branch. Below Omega = 0.04 or so a branch of one period needs more, and the cost
#: grows with their square, to 0.4 s at this limit.
MAX_GRID: Final = 2_000

#: Maximum stored points of a branch and maximum stored events of a cell.
MAX_POINTS: Final = 1_000
MAX_EVENTS: Final = 1_000

#: Core-seconds of a branch over the square of its flight times (`python -m benchmarks.branches`).
SECONDS: Final = 7e-8

_DIMS: Final = ("xi", "omega")
_MODE: Final = re.compile(r"([1-9][0-9]{0,3})-([1-9][0-9]{0,3})")


class Mode(NamedTuple):
    """A cycle's bounces and plate periods, written as `1-2`."""

    bounces: int
    periods: int

    def __str__(self) -> str:
        return f"{self.bounces}-{self.periods}"


def read_mode(text: str) -> Mode:
    """Parse a mode of one bounce. Raises BrokenRuleError."""
    match = _MODE.fullmatch(text)
    if match is None:
        raise BrokenRuleError("", f"must be like 1-2 (bounces-periods), not {describe(text)}")
    mode = Mode(int(match[1]), int(match[2]))
    if mode.bounces != 1:
        rule = "must have one bounce, as 1-1 or 1-2: other modes are found from the cells of a sweep"
        raise BrokenRuleError("", f"{rule}, not {mode}")
    if mode.periods > MAX_PERIODS:
        raise BrokenRuleError("", f"must have at most {MAX_PERIODS} periods, not {mode.periods}")
    return mode


def check_modes(modes: Sequence[Mode]) -> None:
    """Raise BrokenRuleError for too many or repeated modes."""
    if len(set(modes)) < len(modes):
        raise BrokenRuleError("", "must not name a mode twice")
    if not 1 <= len(modes) <= MAX_MODES:
        raise BrokenRuleError("", f"must be 1 to {MAX_MODES} modes, not {len(modes)}")


def grid_points(omega: NDArray[np.float64], periods: int, points: int) -> NDArray[np.float64]:
    """Approximate number of flight times of a branch at each omega (n,), for an undamped spring.

    See `kernel.branches.events.flight_times`; fewer with damping, except near both ends.
    """
    rate = 1.0 + (1.0 + math.sqrt(2.0)) / omega
    return np.maximum(2.0 * math.pi * periods * rate / 0.2, points)


def _to_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


def _mode(name: str) -> str:
    return str(read_mode(name))


def _modes(names: tuple[str, ...]) -> tuple[str, ...]:
    check_modes([read_mode(name) for name in names])
    return names


Modes = Annotated[
    tuple[Annotated[str, AfterValidator(_mode)], ...], BeforeValidator(_to_tuple), AfterValidator(_modes)
]


class Orbits(Strict):
    """The protocol; its kind selects the study."""

    kind: Literal["orbits"]


class OrbitsSpec(Specification):
    """A grid of springs, the modes of the branches, and the length of the records.

    `OrbitsSpec(omega=..., xi=..., protocol=...)` raises `SpecInvalid`, which names each field and rule.
    """

    AXES: ClassVar = _DIMS

    omega: Annotated[Axis, AfterValidator(within(SMALLEST, LARGEST))]
    xi: Annotated[Axis, AfterValidator(within(0.0, LARGEST))]
    protocol: Orbits
    modes: Modes = ("1-1", "1-2")
    gamma_max: Annotated[float, Field(gt=0.0, le=LARGEST), NUMBER] = 8.0
    points: Annotated[int, Field(ge=10, le=MAX_POINTS), WHOLE] = 128
    events: Annotated[int, Field(ge=1, le=MAX_EVENTS), WHOLE] = 128

    @model_validator(mode="after")
    def _rules(self) -> Self:
        longest = max(mode.periods for mode in self.cycles)
        lowest = self.axis_values("omega")[:1]
        if grid_points(lowest, longest, GRID)[0] > MAX_GRID:
            rate = MAX_GRID * 0.2 / (2.0 * math.pi * longest) - 1.0
            needed = math.ceil(1000.0 * (1.0 + math.sqrt(2.0)) / rate) / 1000.0
            rule = f"must be at least {needed:g} for 1-{longest}, whose branch takes too many points below"
            raise BrokenRuleError("omega", f"{rule}, not {float(lowest[0])!r}")
        return self

    @property
    def cycles(self) -> tuple[Mode, ...]:
        """The modes, in the order of the dimension `branch`."""
        return tuple(read_mode(name) for name in self.modes)

    @property
    def shape(self) -> tuple[int, int]:
        """Cells along (xi, omega)."""
        return len(self.axis_values("xi")), len(self.axis_values("omega"))


def make_plan(
    spec: OrbitsSpec, chunk_shape: tuple[int, ...] | None = None, longest: float = LONGEST_SECONDS
) -> Plan:
    """Chunks of `chunk_shape` cells along (xi, omega); by default rows of omega, about a second of work.

    Raises ValueError for a size below 1.
    """
    if chunk_shape is None:
        all_cells = math.prod(spec.shape)
        fitting = min(
            TARGET_SECONDS / (_seconds(spec) / all_cells), MAX_CHUNK_BYTES / bytes_of(ARRAYS, _sizes(spec))
        )
        cells = max(1, int(min(fitting, math.ceil(all_cells / 8))))
        row = even(spec.shape[1], cells)
        chunk_shape = (max(1, cells // row), row)
    return Plan(spec.shape, chunk_shape)


def estimate(spec: OrbitsSpec, plan: Plan) -> Cost:
    """Cost of a study."""
    size = plan.cells * bytes_of(ARRAYS, _sizes(spec))
    return Cost(cells=plan.cells, chunks=len(plan), bytes=size, core_seconds=_seconds(spec))


def _seconds(spec: OrbitsSpec) -> float:
    """Core-seconds of the whole grid."""
    omega = spec.axis_values("omega")
    squares = sum(float((grid_points(omega, k, GRID) ** 2).sum()) for _, k in spec.cycles)
    return SECONDS * squares * spec.shape[0]


_KINDS: Final = tuple(Kind)

_POINT, _EVENT = (*_DIMS, "branch", "point"), (*_DIMS, "event")
_LENGTH, _SPEED = "plate amplitudes", "plate amplitudes per rad"


def _admissible(name: str, dims: tuple[str, ...]) -> Array:
    meanings = "gap_negative_in_flight force_negative_in_contact no_takeoff"
    return array(
        name, dims, "|u1", "why the cycle is not one of the spring",
        flag_masks=[1, 2, 4], flag_meanings=meanings, comment="0: a cycle of the spring",
    )  # fmt: skip


#: The stored arrays in the order they are written.
ARRAYS: Final = (
    array("gamma", _POINT, "<f8", "plate acceleration over gravity",
          comment="NaN: no point; one between the parts of a branch that leaves gamma_max"),
    array("flight_time", _POINT, "<f8", "flight time", "rad"),
    array("takeoff_phase", _POINT, "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
    array("elongation", _POINT, "<f8", "elongation of the spring at take-off", _LENGTH),
    array("elongation_velocity", _POINT, "<f8", "velocity of the elongation at take-off", _SPEED),
    array("impact_velocity", _POINT, "<f8", "velocity of the gap before landing", _SPEED),
    array("multiplier", _POINT, "<c16", "Floquet multiplier, the larger in modulus"),
    array("other_multiplier", _POINT, "<c16", "the other Floquet multiplier"),
    array("stable", _POINT, "|b1", "whether both multipliers are inside the unit circle"),
    _admissible("admissible", _POINT),
    array("event_kind", _EVENT, "|u1", "kind of event",
          flag_values=list(range(len(_KINDS) + 1)), flag_meanings=" ".join(["none", *_KINDS])),
    array("event_gamma", _EVENT, "<f8", "plate acceleration over gravity"),
    array("event_bounces", _EVENT, "<i4", "bounces of the cycle"),
    array("event_periods", _EVENT, "<i4", "plate periods of the cycle"),
    array("event_flight_time", _EVENT, "<f8", "flight time", "rad"),
    _admissible("event_admissible", _EVENT),
    array("event_count", _DIMS, "<i4", "events of the cell, also those beyond the dimension event"),
    whether_computed(_DIMS, "unresolved"),
)  # fmt: skip


def _sizes(spec: OrbitsSpec) -> dict[str, int]:
    return {"branch": len(spec.modes), "point": spec.points, "event": spec.events}


def layout(spec: OrbitsSpec, chunk_shape: tuple[int, ...]) -> Layout:
    """Layout of the store with chunks of `chunk_shape` cells along (xi, omega)."""
    names = np.array(spec.modes, dtype=np.dtypes.StringDType())
    branch = {"branch": (names, {"long_name": "mode of the branch: bounces-periods"})}
    title, model = "bouncing spring: cycles in closed form", "rigid, restitution 0"
    return grid_layout(spec, chunk_shape, ARRAYS, _sizes(spec), branch, title, model)


def run_chunk(spec: OrbitsSpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute every cell of `chunk` and store it, without pauses; the store must exist.

    Raises ChunkCancelled or a `store.StoreError`; then nothing of the chunk was written.
    """
    record = empty_record(chunk.shape, ARRAYS, _sizes(spec))
    xi, omega = (spec.axis_values(axis)[span] for axis, span in zip(_DIMS, chunk.slices, strict=True))
    work, began = Work(store_url, chunk, ARRAYS, record), time.perf_counter()
    for i, j in np.ndindex(chunk.shape):
        work.check_cancelled()
        _compute(spec, float(omega[j]), float(xi[i]), {name: x[i, j : j + 1] for name, x in record.items()})
    work.kernel_seconds = time.perf_counter() - began
    return work.write(record)


def _compute(spec: OrbitsSpec, omega: float, xi: float, cell: dict[str, NDArray[Any]]) -> None:
    """Fill in one cell: arrays (1, ...) of a record."""
    events_of_branches: list[Events] = []
    try:
        for row, mode in enumerate(spec.cycles):
            branch, events = branch_and_events(omega, xi, mode.periods, max(GRID, spec.points))
            _put_branch(branch, row, spec, cell)
            events_of_branches.append(events)
    except KernelInputError:  # an undamped spring at resonance
        cell["outcome"][0] = Outcome.UNRESOLVED
        return
    inside = [events.gamma <= spec.gamma_max for events in events_of_branches]
    cell["event_count"][0] = sum(int(rows.sum()) for rows in inside)
    at = 0
    for events, rows in zip(events_of_branches, inside, strict=True):
        for i in np.flatnonzero(rows)[: spec.events - at]:
            cell["event_kind"][0, at] = 1 + _KINDS.index(Kind(events.kind[i]))
            for name in ("gamma", "bounces", "periods", "flight_time", "admissible"):
                cell[f"event_{name}"][0, at] = getattr(events, name)[i]
            at += 1
    cell["outcome"][0] = Outcome.PERIODIC


def _put_branch(branch: Branch, row: int, spec: OrbitsSpec, cell: dict[str, NDArray[Any]]) -> None:
    """Fill in one branch, thinned to the available points."""
    kept = _stored_rows(branch.gamma <= spec.gamma_max, spec.points)
    to = np.flatnonzero(kept >= 0)
    rows = kept[to]
    for name in ("gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity",
                 "impact_velocity", "stable", "admissible"):  # fmt: skip
        cell[name][0, row, to] = getattr(branch, name)[rows]
    for i, name in enumerate(("multiplier", "other_multiplier")):
        cell[name][0, row, to] = branch.multiplier[rows, i]


def _stored_rows(inside: NDArray[np.bool_], points: int) -> NDArray[np.intp]:
    """Rows of a branch to store: indices (m,), m <= points, with -1 between its parts.

    Includes the first and last row, and both ends of every part if they fit.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]))).reshape(-1, 2)
    parts: list[NDArray[np.intp]] = []
    for low, high in edges:
        parts += [np.arange(low, high), np.array([-1])]
    order = np.concatenate([np.empty(0, np.intp), *parts])[:-1]
    if len(order) <= points:
        return order
    gaps = np.flatnonzero(order < 0)
    even = np.unique(np.concatenate([gaps, np.linspace(0, len(order) - 1, points).round().astype(np.intp)]))
    surplus = len(even) - points
    if surplus > 0:  # gaps take the place of rows
        rows = np.flatnonzero(order[even] >= 0)[1:-1]
        even = np.delete(even, rows[np.linspace(0, len(rows) - 1, surplus).round().astype(np.intp)])
    return np.asarray(order[even])
