"""The audit of a stored sweep: how many of its cells a reference would change, from samples computed again.

There are two questions. `numerics` asks for the same contact, computed cell by cell with the scalar
functions, without any early end, and with windows LONGER times as long. `model` asks for the contact that the
specification approximates, if it names one. Each cell of a ramp is computed again from the stored state of
the cell before. So cells are independent of each other, and the audit judges the step from cell to cell.

A simple random sample has the interval of `worker.analysis.intervals`. The sample of `numerics` is drawn from
the cells that are not certified within the tolerance. Hard cells are looked at besides, outside any interval:
the corners of the grid, and cells next to another mode.

The reference shares closed forms and root search with the sweep. So resting and periodic cells of a soft
contact are also followed from their last states by `stepped`, which uses neither.

`python -m worker.analysis.audit` compiles the kernels of the sweep on the first line of its input, then those
of its audit, and writes a line after each. It ends with its input.
"""

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.labels import label_codes
from kernel.line import LineRun
from kernel.params import Cell, Line, Outcome, Start, empty_line
from worker import store
from worker.analysis.bisection import Status, endless_rest, on_grid
from worker.analysis.deviation import deviations, nearest, sorted_apart
from worker.spec.contact_models import MIN_RESTITUTION, Contact, Soft, Stepped
from worker.study import Chunk
from worker.study.layout import CELL_DIMS, COMPUTED
from worker.sweep import AXES, SweepSpec, schema
from worker.sweep.plan import mean_periods, period_seconds
from worker.sweep.task import run_cells, starts_of, to_end
from worker.work import plate_of

#: Any cell.
_ANY: Final = (Cell(1.0, 1.0, 1.0),)
#: Windows of the reference relative to the sweep's.
LONGER: Final = 10
#: Flights of a cell that the reference keeps, at least and at most: the store may keep less than a cycle.
FEWEST_KEPT, MOST_KEPT = 256, 4096
#: Fewest kept flights that give the distribution of a cell that does not repeat and has more.
FEWEST_TOLD: Final = 32
#: Relative change of a start. The cell is undecided if its answer changes with it.
MOVED: Final = 1e-12
#: Number of hard cells next to another mode.
BESIDE: Final = 16
#: Calls of `look` into which an audit is divided.
PARTS: Final = 8

#: The two time steps, contact / STEPS, whose flights are extrapolated: the error is of second order.
STEPS: Final = (100, 200)
#: Plate periods after which the time stepper is on its own cycle.
FOLLOWED: Final = 20

#: Core-seconds of references that one answer may take.
MAX_SECONDS: Final = 3_600.0

#: The sets of cells: samples of both questions, hard cells, points anywhere in the plane, the two cells of a
#: threshold, and cells followed by time steps.
SETS: Final = ("numerics", "model", "besides", "area", "threshold", "integrator")

_Array = NDArray[Any]


#: Values that `look` returns for each cell, in lists, which JSON can hold.
FIELDS: Final = (
    "set",  # index in SETS
    "unit",  # the cells of one threshold have the same number
    "direction",  # index
    "gamma", "omega", "xi",
    "outcome", "bounces", "periods", "label",  # stored; for a point those of the nearest cell
    "true_outcome", "true_bounces", "true_periods", "true_label",  # of the reference
    "deviation",  # of flights, rad; -1: infinite, -2: unknown, None: the cell has no flights of its own
    "undecided",
)  # fmt: skip


#: Values that `look` returns for the sweep.
SIZES: Final = (
    "cells", "thresholds",
    "certified",  # cells whose flights are certified within the tolerance
    "certified_error",  # the largest `flight_error` of these, rad
    "repeating",  # cells at rest or periodic
)  # fmt: skip


class _Drawn(NamedTuple):
    """A cell, or a point near it, to compute again."""

    set: str
    unit: int  # number in its set; both cells of a threshold have the same
    indices: tuple[int, ...]  # of the cell: direction, xi, omega, gamma
    point: Cell | None = None


def steppers(spec: SweepSpec) -> tuple[Stepped, ...]:
    """The contact of a sweep with the time steps of STEPS; none if it cannot be stepped."""
    if not isinstance(spec.model, Soft) or spec.model.restitution < MIN_RESTITUTION:
        return ()
    fields = spec.model.model_dump(exclude={"kind"})
    return tuple(Stepped(**fields, steps_per_contact=steps) for steps in STEPS)


def look(
    spec: SweepSpec, url: str, contact: Contact | None, cells: int, followed: int, seed: int,
    tolerance: float, part: int,
) -> dict[str, Any]:  # fmt: skip
    """Compute a part of the drawn cells again; every part draws the same cells.

    contact: for the question `model`. cells: size of each sample. followed: number of cells followed by time
    steps. tolerance: of flights, rad. Returns the lists of FIELDS and the values of SIZES. Raises a
    `store.StoreError`.
    """
    names = ["outcome", "bounces", "periods"]
    names += [COMPUTED] * spec.fills_in + ["flight_error"] * spec.certifies
    grid = store.read_slice(url, names, complete=True)
    drawn, sizes = _draw(spec, grid, contact is not None, cells, followed, seed, tolerance)
    mine = drawn[part::PARTS]
    rows: list[tuple[Any, ...]] = []
    for name in SETS:
        chosen = [cell for cell in mine if cell.set == name]
        if chosen and name == "integrator":
            rows += (_stepped(spec, url, grid, cell, tolerance) for cell in chosen)
        elif chosen:
            rows += _compared(spec, url, grid, contact if name == "model" else None, chosen)
    columns = zip(*rows, strict=True) if rows else ([] for _ in FIELDS)
    return {name: list(column) for name, column in zip(FIELDS, columns, strict=True)} | sizes


# Drawing


def _draw(
    spec: SweepSpec, grid: dict[str, _Array], with_model: bool, cells: int, followed: int, seed: int,
    tolerance: float,
) -> tuple[list[_Drawn], dict[str, Any]]:  # fmt: skip
    """The cells of all sets, and the values of SIZES."""
    random = np.random.default_rng(seed)
    outcome = grid["outcome"]
    errors = grid.get("flight_error", np.full(outcome.shape, np.nan))
    certified = errors <= tolerance
    drawn = list(_sample(random, "numerics", cells, ~certified))
    if with_model:
        drawn += _sample(random, "model", cells, np.ones_like(certified))
    drawn += _hard_cells(random, grid)
    if spec.ramp_axis is None:
        drawn += _points(random, spec, cells // 2)
    lines = list(_thresholds(spec, outcome)) if spec.ramp_axis in (None, "gamma") else []
    chosen = random.permutation(len(lines))[: max(cells // 4, 1)]
    drawn += [_Drawn("threshold", int(i), index) for i in chosen for index in lines[i]]
    repeating = np.isin(outcome, (Outcome.AT_REST, Outcome.PERIODIC)) & grid.get(COMPUTED, np.True_)
    if steppers(spec):
        drawn += _sample(random, "integrator", followed, repeating)
    sizes = (outcome.size, len(lines), int(np.count_nonzero(certified)),
             float(np.max(errors[certified], initial=0.0)), int(np.count_nonzero(repeating)))  # fmt: skip
    return drawn, dict(zip(SIZES, sizes, strict=True))


def _sample(random: np.random.Generator, name: str, cells: int, mask: NDArray[np.bool_]) -> Iterator[_Drawn]:
    """A simple random sample, without replacement, of the cells of a mask."""
    population = np.flatnonzero(mask)
    chosen = random.choice(population, min(cells, len(population)), replace=False)
    for i, index in enumerate(np.stack(np.unravel_index(chosen, mask.shape), axis=1).tolist()):
        yield _Drawn(name, i, tuple(index))


def _hard_cells(random: np.random.Generator, grid: dict[str, _Array]) -> Iterator[_Drawn]:
    """The corners of the grid, and cells next to another outcome or mode."""
    outcome = grid["outcome"]
    key = outcome.astype(np.int64) + 16 * (grid["bounces"].astype(np.int64) + 2**20 * grid["periods"])
    beside = np.zeros(outcome.shape, bool)
    for axis in range(1, outcome.ndim):
        differs, along = (np.moveaxis(x, axis, 0) for x in (np.diff(key, axis=axis) != 0, beside))
        along[:-1] |= differs
        along[1:] |= differs
    corners = set(product(range(outcome.shape[0]), *({0, n - 1} for n in outcome.shape[1:])))
    cells = np.flatnonzero(beside)
    chosen = random.choice(cells, min(BESIDE, len(cells)), replace=False)
    indices = sorted(corners | {tuple(map(int, np.unravel_index(i, outcome.shape))) for i in chosen})
    return (_Drawn("besides", i, index) for i, index in enumerate(indices))


def _points(random: np.random.Generator, spec: SweepSpec, number: int) -> Iterator[_Drawn]:
    """Points anywhere in the sweep, evenly between its cells, each with the nearest cell."""
    axes = [spec.axis_values(axis) for axis in AXES]
    if all(len(values) == 1 for values in axes):
        return
    for i in range(number):
        places = [random.uniform(0.0, len(values) - 1.0) for values in axes]
        along = zip(places, axes, strict=True)
        xi, omega, gamma = (float(np.interp(x, np.arange(len(values)), values)) for x, values in along)
        yield _Drawn("area", i, (0, *map(round, places)), Cell(gamma, omega, xi))


def _thresholds(spec: SweepSpec, outcome: _Array) -> Iterator[tuple[tuple[int, ...], ...]]:
    """The two cells of each threshold on the grid: the one at rest and the one that bounces."""
    if outcome.shape[-1] < 2:
        return
    for xi, value in enumerate(spec.axis_values("xi")):
        endless = endless_rest(spec, spec.axis_values("omega"), float(value))
        for direction, name in enumerate(spec.directions):
            for omega in range(outcome.shape[2]):
                on = on_grid(outcome[direction, xi, omega], name == "down", bool(endless[omega]))
                if on.status is Status.FOUND and on.resting is not None and on.bouncing is not None:
                    yield (direction, xi, omega, on.resting), (direction, xi, omega, on.bouncing)


# Looking


def _compared(
    spec: SweepSpec, url: str, grid: dict[str, _Array], contact: Contact | None, drawn: Sequence[_Drawn]
) -> Iterator[tuple[Any, ...]]:
    """The values of FIELDS for drawn cells of one set."""
    cells = [cell.point or spec.cell_at(*cell.indices[1:]) for cell in drawn]
    starts = [_start(spec, url, cell.indices) for cell in drawn]
    true, undecided = reference(spec, cells, starts, contact)
    stored = _stored(spec, url, grid, drawn)
    apart = deviations(true, stored, spec.micro_flight, FEWEST_TOLD)
    modes, true_modes = _modes(spec, stored, 1), _modes(spec, true, LONGER)
    for i, cell in enumerate(drawn):
        own = cell.point is None and (COMPUTED not in grid or bool(grid[COMPUTED][cell.indices]))
        deviation = float(apart[i]) if own else None
        yield _row(cell, cells[i], modes[i], true_modes[i], deviation, bool(undecided[i]))


def _row(
    drawn: _Drawn, cell: Cell, mode: tuple[int, ...], true_mode: tuple[int, ...], deviation: float | None,
    undecided: bool,
) -> tuple[Any, ...]:  # fmt: skip
    """The values of FIELDS, which are stored as JSON; modes as of `_modes`."""
    field = deviation
    if deviation is not None and not np.isfinite(deviation):
        field = -2.0 if np.isnan(deviation) else -1.0
    place = SETS.index(drawn.set), drawn.unit, drawn.indices[0]
    return *place, *cell, *mode, *true_mode, field, undecided


def reference(
    spec: SweepSpec, cells: Sequence[Cell], starts: Sequence[Start | None], contact: Contact | None = None
) -> tuple[Line, NDArray[np.bool_]]:
    """The reference of n cells, each from its start or from rest, and which of them it leaves undecided (n,).

    contact: by default the sweep's. A cell is undecided if it still settles, or if its answer changes when
    its start moves by MOVED.
    """
    true = to_end(_reference(spec, cells, starts, contact))
    differ = modes_differ(true, to_end(_reference(spec, *_moved(cells, starts), contact)))
    return true, differ | np.isin(true.outcome, (Outcome.SETTLING, Outcome.UNRESOLVED))


def modes_differ(a: Line, b: Line) -> NDArray[np.bool_]:
    """Which cells have another outcome or mode in the other line, (n,)."""
    differ = [getattr(a, name) != getattr(b, name) for name in schema.MODE_ARRAYS]
    return np.asarray(np.any(differ, axis=0))


def is_compiled(spec: SweepSpec, contact: Contact | None) -> bool:
    """Whether `reference` compiles nothing."""
    return _reference(spec, _ANY, [None], contact).is_compiled()


def compile_for(spec: SweepSpec) -> None:
    """Compile, or load, the functions that `reference` runs for a sweep's own contact."""
    _reference(spec, _ANY, [None], None).advance(1)


def _reference(
    spec: SweepSpec, cells: Sequence[Cell], starts: Sequence[Start | None], contact: Contact | None
) -> LineRun:
    settle, observe = (LONGER * max(periods, 1) for periods in spec.window)
    until = spec.settles_until
    return _scalar_run(
        contact or spec.model, cells, starts, settle=settle, observe=observe,
        settle_until=None if until is None else LONGER * until,
        keep=max(spec.keep, min(max(LONGER * spec.keep, FEWEST_KEPT), MOST_KEPT)),
        micro_flight=spec.micro_flight,
        exponents=spec.exponents if contact is None else 0,
    )  # fmt: skip


def _scalar_run(
    model: Contact, cells: Sequence[Cell], starts: Sequence[Start | None], **window: Any
) -> LineRun:
    """Cells by the scalar functions, each from its start or from rest, at their beginning."""
    gamma, omega, xi = np.array(cells, np.float64).reshape(-1, 3).T.copy()
    plate = plate_of(model, gamma, omega, xi)
    return LineRun(gamma, omega, xi, plate=plate, carry=True, start=list(starts), in_lanes=False, **window)


def followed_seconds(spec: SweepSpec) -> float:
    """Core-seconds of a cell followed by time steps, by the table of contact models."""
    stepped = (spec.model_copy(update={"model": model}) for model in steppers(spec))
    return sum((FOLLOWED + 8) * period_seconds(sweep) for sweep in stepped)


def reference_seconds(spec: SweepSpec) -> float:
    """Core-seconds of the reference of one cell, from both starts, by the table of contact models."""
    return 2.0 * LONGER * mean_periods(spec) * period_seconds(spec, alone=True)


def _stepped(
    spec: SweepSpec, url: str, grid: dict[str, _Array], drawn: _Drawn, tolerance: float
) -> tuple[Any, ...]:
    """The values of FIELDS for a cell at rest or periodic, followed from its last state by time steps.

    Undecided if the two time steps differ by more than the tolerance.
    """
    cell, stored = spec.cell_at(*drawn.indices[1:]), _stored(spec, url, grid, [drawn])
    ended = run_cells(spec, [np.array([value]) for value in cell], _start(spec, url, drawn.indices))
    start = Start(np.ascontiguousarray(ended.end_state[0]), cell)
    bounces, periods = int(stored.bounces[0]), max(int(stored.periods[0]), 1)
    window = {
        "settle": FOLLOWED,
        "observe": 2 * periods,
        "keep": MOST_KEPT,
        "micro_flight": spec.micro_flight,
    }
    lines = [stored, *(to_end(_scalar_run(model, [cell], [start], **window)) for model in steppers(spec))]
    short = bounces and not np.any(stored.flight_time > spec.micro_flight)  # then all flights count
    own, coarse, fine = (_last(line, 0.0 if short else spec.micro_flight, bounces) for line in lines)
    deviation, decided = np.inf, len(coarse) == len(fine)
    part = len(own) < bounces  # less than a cycle is kept
    if decided and (len(own) == len(fine) or (part and len(fine))):
        extrapolated = fine + (fine - coarse) / ((STEPS[1] / STEPS[0]) ** 2 - 1.0)
        deviation = (nearest if part else sorted_apart)(extrapolated, own)
        decided = bool(np.max(np.abs(fine - coarse), initial=0.0) <= tolerance)
    [mode] = _modes(spec, stored, 1)
    return _row(drawn, cell, mode, mode, deviation, not decided)


def _last(line: Line, micro_flight: float, bounces: int) -> _Array:
    """The flights longer than `micro_flight` in the last cycle of the first cell, rad."""
    flights = line.flight_time[0, : line.flights[0]]
    flights = flights[flights > micro_flight]
    return flights[-bounces:] if bounces else flights


def _start(spec: SweepSpec, url: str, index: tuple[int, ...]) -> Start | None:
    direction, *cell = index
    chunk = Chunk(0, tuple((i, i + 1) for i in cell), direction)
    return starts_of(spec, chunk, url, complete=True).get((0, 0))


def _moved(cells: Sequence[Cell], starts: Sequence[Start | None]) -> tuple[list[Cell], list[Start | None]]:
    """The cells with each start moved by MOVED; from rest gamma moves instead."""
    moved_cells, moved_starts = list(cells), list(starts)
    for i, (cell, start) in enumerate(zip(cells, starts, strict=True)):
        if start is None:
            moved_cells[i] = cell._replace(gamma=cell.gamma * (1.0 + MOVED))
        else:
            state = np.array(start.state)
            state[4] += MOVED * max(1.0, abs(state[4]))
            moved_starts[i] = start._replace(state=state)
    return moved_cells, moved_starts


def _stored(spec: SweepSpec, url: str, grid: dict[str, _Array], drawn: Sequence[_Drawn]) -> Line:
    """The stored record of the cells; for a point that of the nearest cell."""
    exponents = ("lyapunov", "lyapunov_error") if spec.exponents else ()
    names = ("flight_time", "takeoff_phase", "flights", *exponents)
    cells: list[dict[str, Any]] = [dict(zip(CELL_DIMS, cell.indices, strict=True)) for cell in drawn]
    parts = [store.read_slice(url, names, complete=True, **cell) for cell in cells]
    records = {name: np.stack([part[name] for part in parts]) for name in names}
    modes = {name: np.array([grid[name][cell.indices] for cell in drawn]) for name in schema.MODE_ARRAYS}
    return empty_line(len(drawn), spec.keep, spec.exponents)._replace(**records, **modes)


def _modes(spec: SweepSpec, line: Line, longer: int) -> list[tuple[int, ...]]:
    """Outcome, bounces, periods and label of each cell; without exponents the outcome is the label."""
    label = line.outcome
    if line.lyapunov.shape[1]:
        label = label_codes(line.outcome, line.lyapunov, line.lyapunov_error, longer * spec.observe)
    arrays = (*(getattr(line, name) for name in schema.MODE_ARRAYS), label)
    return list(zip(*(array.tolist() for array in arrays), strict=True))


if __name__ == "__main__":
    from worker.kernel_cache import use_cache
    from worker.work import compile_for as compile_kernels_for

    def end_with_input() -> None:
        """End this process with the one that started it, which may be killed."""
        sys.stdin.read()
        os._exit(1)

    sweep = SweepSpec.from_json(sys.stdin.readline())
    threading.Thread(target=end_with_input, daemon=True).start()
    use_cache()
    for compile_all in (compile_kernels_for, compile_for):
        compile_all(sweep)
        sys.stdout.write("compiled\n")
        sys.stdout.flush()
