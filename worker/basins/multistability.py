"""The study `multistability`: the attractors of every cell of a grid, followed along gamma (docs/basins.md).

A task computes whole lines along gamma. It starts each cell from the attractors of both neighbours and stores
the attractors reached: two attractors of neighbouring cells are the same if each leads to the other.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.cell import rescale
from kernel.params import Line, Outcome, counted_flights
from worker.basins.attractors import CYCLE_REPRESENTATIVES, LONG_CYCLE, SAME_CYCLE, sizes_of_runs
from worker.basins.schema import FOLLOWED_ARRAYS, MAX_FOLLOWED, sizes_of_attractors
from worker.basins.specification import MAX_DROPS, MultistabilitySpec
from worker.basins.starts import Steps, starts_of
from worker.study.chunks import Chunk, ChunkReport
from worker.sweep import AXES

#: Longest flights by which cycles of one mode are distinguished.
CYCLE: Final = 32

#: Passes of lines in both directions: attractors found on the way down are followed up again.
ROUNDS: Final = 3

#: Values of `next_up` and `next_down`: not started; started without reaching an attractor.
NOT_STARTED: Final = -1
NOWHERE: Final = 0

#: Stored names of fields of `Reached`, where they differ.
_STORED: Final = {"outcome": "attractor_outcome", "state": "attractor_state"}

_Arrays = dict[str, NDArray[Any]]


class Reached(NamedTuple):
    """The end of a run."""

    outcome: int  # an Outcome
    bounces: int  # 0 without a cycle
    periods: int
    cycle: NDArray[np.float64]  # (CYCLE,) longest flights of the cycle, the longest first, rad; NaN beyond
    longest_flight: float  # rad
    state: NDArray[np.float64]  # (len(STATE_FIELDS),) at phase 0
    flight_time: NDArray[np.float64]  # (keep,) of its window
    takeoff_phase: NDArray[np.float64]

    @property
    def decided(self) -> bool:
        """Whether it ends on an attractor."""
        return self.outcome in (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.AT_REST)

    @property
    def order(self) -> tuple[float, ...]:
        """The order of attractors with equal fractions."""
        return (self.outcome, self.bounces, self.periods, -self.longest_flight)

    def same(self, other: "Reached") -> bool:
        """Whether both end on one attractor of a cell."""
        modes = [(r.outcome, r.bounces, r.periods) for r in (self, other)]
        return modes[0] == modes[1] and not np.any(np.abs(self.cycle - other.cycle) > SAME_CYCLE)


def _reduced(line: Line, micro_flight: float, keep: int) -> _Arrays:
    """The fields of `Reached` for the n runs of a record, arrays (n, ...)."""
    n = len(line.outcome)
    ends = {
        "outcome": line.outcome.astype(np.int64), "bounces": np.zeros(n, np.int64),
        "periods": np.zeros(n, np.int64), "cycle": np.full((n, CYCLE), np.nan),
        "longest_flight": np.zeros(n), "state": line.end_state,
        "flight_time": np.full((n, keep), np.nan), "takeoff_phase": np.full((n, keep), np.nan),
    }  # fmt: skip
    for i, outcome in enumerate(line.outcome):
        time, phase = counted_flights(line, i, micro_flight)
        if outcome == Outcome.PERIODIC:
            ends["bounces"][i], ends["periods"][i] = line.bounces[i], line.periods[i]
            longest = np.sort(time[len(time) - line.bounces[i] :])[::-1][:CYCLE]
            ends["cycle"][i, : len(longest)] = longest
            ends["longest_flight"][i] = longest[0]
        elif outcome == Outcome.APERIODIC and len(time):
            ends["longest_flight"][i] = time.max()
        last = min(keep, len(time))
        ends["flight_time"][i, :last] = time[len(time) - last :]
        ends["takeoff_phase"][i, :last] = phase[len(time) - last :]
    return ends


class _Cells:
    """The known attractors in the cells of a chunk: the arrays of its record as (lines, gammas, ...)."""

    def __init__(self, record: _Arrays) -> None:
        self.arrays = {name: array.reshape(-1, *array.shape[2:]) for name, array in record.items()}

    def id_of(self, line: int, j: int, end: Reached) -> int | None:
        """The id of the stored attractor of a cell on which a run ends; None if there is none."""
        for k in range(min(int(self.arrays["attractor_count"][line, j]), MAX_FOLLOWED)):
            fields = (self.arrays[_STORED.get(name, name)][line, j, k] for name in Reached._fields)
            if end.same(Reached(*fields)):
                return k + 1
        return None

    def add(self, line: int, j: int, reached: Reached, fraction: float) -> int:
        """Store a further attractor of a cell; returns its id, or NOWHERE if there is no room."""
        k = int(self.arrays["attractor_count"][line, j])
        self.arrays["attractor_count"][line, j] += 1
        if k >= MAX_FOLLOWED:
            return NOWHERE
        for name, value in reached._asdict().items():
            self.arrays[_STORED.get(name, name)][line, j, k] = value
        self.arrays["fraction"][line, j, k] = fraction
        self.arrays["next_up"][line, j, k] = self.arrays["next_down"][line, j, k] = NOT_STARTED
        return k + 1

    def waiting(self, name: str, j: int) -> list[tuple[int, int]]:
        """The attractors (line, index) of the cells `j` not yet followed towards `name`."""
        count = np.minimum(self.arrays["attractor_count"][:, j], MAX_FOLLOWED)
        waits = (self.arrays[name][:, j] == NOT_STARTED) & (np.arange(MAX_FOLLOWED) < count[:, None])
        return [(int(line), int(k)) for line, k in np.argwhere(waits)]


class _Search:
    """The runs that find the attractors of a chunk."""

    def __init__(self, spec: MultistabilitySpec, chunk: Chunk, cells: _Cells, work: Steps) -> None:
        self._spec, self._cells, self._work = spec, cells, work
        axes = dict(zip(AXES, chunk.slices, strict=True))
        xi, omega, self._gamma = (spec.axis_values(axis)[span] for axis, span in axes.items())
        xi_grid, omega_grid = np.meshgrid(xi, omega, indexing="ij")
        self._xi, self._omega = xi_grid.ravel(), omega_grid.ravel()  # of each line
        self._longer = spec.until - 2 * (spec.settle + spec.observe) - spec.observe

    def run(self) -> None:
        """Compute every cell. Raises ChunkCancelled, ChunkPaused."""
        gammas = len(self._gamma)
        places = [(line, j) for line in range(len(self._omega)) for j in range(gammas)]
        drops = self._spec.protocol.rows * self._spec.protocol.columns
        block = max(1, sizes_of_runs(self._spec.model)[0] // drops)
        steps = [partial(self._drop, places[i : i + block]) for i in range(0, len(places), block)]
        for _ in range(ROUNDS):
            steps += [partial(self._follow, "next_up", j, j + 1) for j in range(gammas - 1)]
            steps += [partial(self._follow, "next_down", j, j - 1) for j in range(gammas - 1, 0, -1)]
        for step in steps[self._work.done :]:
            step()
            self._work.finish_step()

    def _run(
        self, places: Sequence[tuple[int, int]], states: NDArray[np.float64], settle: int = 0
    ) -> list[Reached]:
        """Run starts (n, len(STATE_FIELDS)), each in its cell (line, j), for at least `settle` periods."""
        spec = self._spec
        lines, js = np.array(places, np.intp).reshape(-1, 2).T
        cells = (self._gamma[js], self._omega[lines], self._xi[lines])
        window = {"settle": max(settle, spec.settle), "observe": spec.observe, "settle_until": spec.until}
        _, keep = sizes_of_runs(spec.model)
        reduce = partial(_reduced, micro_flight=spec.micro_flight, keep=spec.keep)
        answer = self._work.answer(spec, cells, reduce, states=states, keep=keep, **window)
        columns = [x if x.ndim > 1 else x.tolist() for x in map(answer.__getitem__, Reached._fields)]
        return [Reached(*fields) for fields in zip(*columns, strict=True)]

    def _drop(self, places: Sequence[tuple[int, int]]) -> None:
        """Find the attractors that drops reach in the cells `places`."""
        starts = starts_of(self._spec, 1.0, 1.0, 0.0)  # drops are the same in every cell
        n = len(starts)
        first = self._run([place for place in places for _ in range(n)], np.tile(starts, (len(places), 1)))
        ends = [first[i : i + n] for i in range(0, len(first), n)]
        standing = [
            (place, of_cell, members)
            for place, of_cell in zip(places, ends, strict=True)
            for members in _standing(of_cell)
        ]
        if standing:
            states = np.stack([of_cell[members[0]].state for _, of_cell, members in standing])
            later = self._run([place for place, _, _ in standing], states)
            for (_, of_cell, members), end in zip(standing, later, strict=True):
                if end.decided or of_cell[members[0]].outcome == Outcome.APERIODIC:
                    for i in members:
                        of_cell[i] = end
        self._outlast(places, ends)
        for place, of_cell in zip(places, ends, strict=True):
            groups = [[of_cell[i] for i in group] for group in _groups(of_cell)]
            for group in sorted(groups, key=lambda group: (-len(group), *group[0].order)):
                self._cells.add(*place, group[0], len(group) / n)
            self._cells.arrays["undecided"][place] = 1.0 - sum(map(len, groups)) / n

    def _outlast(self, places: Sequence[tuple[int, int]], ends: Sequence[list[Reached]]) -> None:
        """Follow drops that are aperiodic after two windows up to `until`: they may be chaotic transients.

        Follows some drops of each cell, and all of a cell where one ends. Drops that are aperiodic then are
        undecided, unless the others reach only long cycles: a torus looks like one for a while.
        """
        left = dict.fromkeys(range(len(ends)), LONG_CYCLE)  # flights of the shortest cycle reached, by cell
        for most in (CYCLE_REPRESENTATIVES, MAX_DROPS):
            followed = [(cell, i) for cell in left for i in _aperiodic(ends[cell], most)]
            if not followed:
                break
            states = np.stack([ends[cell][i].state for cell, i in followed])
            later = self._run([places[cell] for cell, _ in followed], states, self._longer)
            left = {} if most < MAX_DROPS else left
            for (cell, i), end in zip(followed, later, strict=True):
                if end.outcome != Outcome.SETTLING:
                    ends[cell][i] = end
                if end.outcome in (Outcome.PERIODIC, Outcome.AT_REST):
                    left[cell] = min(left.get(cell, LONG_CYCLE), end.bounces)
        for cell, bounces in left.items():
            for i in _aperiodic(ends[cell], MAX_DROPS) if bounces < LONG_CYCLE else ():
                ends[cell][i] = ends[cell][i]._replace(outcome=Outcome.SETTLING)

    def _follow(self, name: str, j: int, neighbour: int) -> None:
        """Start the cells `neighbour` of all lines from the attractors of the cells `j`."""
        waiting = self._cells.waiting(name, j)
        if not waiting:
            return
        states = np.stack([self._cells.arrays["attractor_state"][line, j, k] for line, k in waiting])
        for state in states:
            rescale(state, self._gamma[j], 1.0, self._gamma[neighbour], 1.0)
        ends = self._run([(line, neighbour) for line, _ in waiting], states)
        # the end of a run that no drop has reached may not have settled yet
        unknown = [
            i
            for i, ((line, _), end) in enumerate(zip(waiting, ends, strict=True))
            if end.decided and self._cells.id_of(line, neighbour, end) is None
        ]
        if unknown:
            places = [(waiting[i][0], neighbour) for i in unknown]
            later = self._run(places, np.stack([ends[i].state for i in unknown]), self._longer)
            for i, (line, _), end in zip(unknown, places, later, strict=True):
                undecided = self._cells.arrays["undecided"][line, neighbour] > 0.0
                transient = undecided and end.outcome == Outcome.APERIODIC
                ends[i] = end._replace(outcome=Outcome.SETTLING) if transient else end
        for (line, k), end in zip(waiting, ends, strict=True):
            reached = NOWHERE
            if end.decided:
                known = self._cells.id_of(line, neighbour, end)
                reached = self._cells.add(line, neighbour, end, 0.0) if known is None else known
            self._cells.arrays[name][line, j, k] = reached


def _standing(ends: Sequence[Reached]) -> list[list[int]]:
    """Groups of a cell's starts, whose first runs on: the starts on one cycle, and each aperiodic start."""
    cycles = [group for group in _groups(ends) if ends[group[0]].outcome == Outcome.PERIODIC]
    return sorted([*cycles, *([i] for i, end in enumerate(ends) if end.outcome == Outcome.APERIODIC)])


def _aperiodic(ends: Sequence[Reached], most: int) -> list[int]:
    """At most this many aperiodic starts of a cell, evenly spaced."""
    aperiodic = [i for i, end in enumerate(ends) if end.outcome == Outcome.APERIODIC]
    return aperiodic[:: -(-len(aperiodic) // most) or 1]


def _groups(ends: Sequence[Reached]) -> list[list[int]]:
    """The starts of a cell that end on an attractor, by attractor."""
    groups: list[list[int]] = []
    for i, end in enumerate(ends):
        if not end.decided:
            continue
        for group in groups:
            if end.same(ends[group[0]]):
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


def run_chunk(spec: MultistabilitySpec, chunk: Chunk, store_url: str) -> ChunkReport:
    """Compute the lines of `chunk` and store them; the store must exist.

    Continues from the chunk's checkpoint, if there is one. Raises `ChunkCancelled`, `ChunkPaused` after
    the slice of `study.chunks.OPTIONS`, or a `store.StoreError`.
    """
    beside = {"cycle": np.full((*chunk.shape, MAX_FOLLOWED, CYCLE), np.nan)}
    work = Steps(store_url, chunk, FOLLOWED_ARRAYS, sizes_of_attractors(spec, MAX_FOLLOWED), beside)
    record = work.record
    _Search(spec, chunk, _Cells(record | beside), work).run()
    for name in ("next_up", "next_down"):
        record[name][record[name] == NOT_STARTED] = NOWHERE  # found too late to be followed
    record["next_up"][..., -1, :] = record["next_down"][..., 0, :] = NOT_STARTED
    any_attractor = record["attractor_count"] > 0
    record["outcome"][...] = np.where(any_attractor, Outcome.PERIODIC, Outcome.UNRESOLVED)
    return work.write()
