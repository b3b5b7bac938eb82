"""The attractors of a stored study of multistability, matched over the plane of one xi.

Along gamma, two attractors of neighbouring cells are one if each leads to the other. What is one along a line
is a branch. Two branches of neighbouring lines are near in the cells where they are of one mode with longest
flights within NEAR, nearer than to others. Branches join to attractors, those first that are near in most
cells, as long as no attractor is twice in a cell. Attractors are numbered from 1 by their cells, those with
most first.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from service.results.counting import attractor_label
from service.results.selection import BASE_MEMORY, Stored, check_points, nearest_index, read_stored
from worker.basins.multistability import MAX_ATTRACTORS
from worker.basins.spec import MultistabilitySpec

#: Cells of one answer, and bytes of memory of each, with its attractors as text.
MAX_CELLS: Final = 2**16
_PER_CELL: Final = 4096
#: Bytes of memory of a flight of a line as text.
_PER_FLIGHT: Final = 100

#: Cycles of neighbouring lines may be one attractor if their longest flights differ by at most this, rad.
NEAR: Final = 1.0

_NAMES: Final = (
    "outcome", "attractor_count", "attractor_outcome", "bounces", "periods", "longest_flight", "fraction",
    "next_up", "next_down",
)  # fmt: skip

_Arrays = Mapping[str, NDArray[Any]]
_Mode = tuple[int, int, int]  # outcome, bounces, periods


class Multistability(Stored[MultistabilitySpec]):
    """Attractors over a grid."""


class Place(NamedTuple):
    """An attractor of one cell."""

    id: int  # in the whole plane
    label: str
    fraction: float  # share of the drops that reach it
    longest_flight: float  # rad


@dataclass(frozen=True)
class Attractor:
    """An attractor of the plane."""

    id: int
    label: str  # its commonest
    cells: int
    gamma: tuple[float, float]  # smallest and largest
    omega: tuple[float, float]
    longest_flight: tuple[float, float]  # rad


@dataclass(frozen=True)
class Event:
    """What happens to an attractor between two neighbouring cells of a line along gamma."""

    kind: str  # birth, death or mode, with gamma growing
    attractor: int
    omega: float
    gamma_below: float
    gamma_above: float
    below: str | None  # its label there; None where it is none
    above: str | None
    leads_to: int | None  # of a birth or death: the attractor of the other cell that it leads to


@dataclass(frozen=True)
class Plane:
    """The attractors over (omega, gamma) at one xi."""

    spec: MultistabilitySpec
    xi: float
    omega: NDArray[np.float64]  # (O,)
    gamma: NDArray[np.float64]  # (G,)
    count: NDArray[np.int64]  # (O, G); -1: not computed
    cells: tuple[tuple[tuple[Place, ...], ...], ...]  # (O, G)
    attractors: tuple[Attractor, ...]
    events: tuple[Event, ...]  # by line and gamma
    complete: bool

    @property
    def several(self) -> float:
        """Share of the computed cells with two attractors or more; NaN if none is computed."""
        return self._share([int(n) for n in self.count.flat if n >= 0])

    @property
    def several_by_drops(self) -> float:
        """The same of attractors that drops reach."""
        places = (cell for line in self.cells for cell in line)
        return self._share(
            [
                sum(place.fraction > 0.0 for place in cell)
                for cell, n in zip(places, self.count.flat, strict=True)
                if n >= 0
            ]
        )

    @staticmethod
    def _share(counts: Sequence[int]) -> float:
        return sum(n >= 2 for n in counts) / len(counts) if counts else np.nan

    def line(self, omega: float) -> "Plane":
        """The line along gamma at the nearest omega, with the ids of the plane. Raises InvalidRequest."""
        at = nearest_index(self.spec, "omega", omega)
        cells = self.cells[at.index]
        present = {place.id for cell in cells for place in cell}
        return Plane(
            self.spec, self.xi, self.omega[[at.index]], self.gamma, self.count[[at.index]], (cells,),
            tuple(attractor for attractor in self.attractors if attractor.id in present),
            tuple(event for event in self.events if event.omega == at.value),
            self.complete,
        )  # fmt: skip


def plane(job: Multistability, xi: float | None) -> Plane:
    """The attractors at the nearest xi; None is the value of an axis that has only one.

    Raises InvalidRequest as `selection.nearest_index`, TooLarge for more than MAX_CELLS cells.
    """
    spec = job.spec
    at = nearest_index(spec, "xi", xi)
    _, omegas, gammas = spec.shape
    check_points(omegas * gammas, MAX_CELLS, f"{omegas:,} by {gammas:,} cells", None)
    arrays = _read(job, _NAMES, xi=at.index)
    computed = arrays["outcome"] != Outcome.MISSING
    count = np.where(computed, arrays["attractor_count"], -1)
    ids = _ids(arrays)
    omega, gamma = spec.axis_values("omega"), spec.axis_values("gamma")
    cells = tuple(tuple(_places(arrays, ids, i, j) for j in range(gammas)) for i in range(omegas))
    return Plane(
        spec, at.value, omega, gamma, count, cells,
        tuple(_attractors(cells, omega, gamma)), tuple(_events(cells, computed, arrays, ids, omega, gamma)),
        bool(computed.all()) and not job.repairing,
    )  # fmt: skip


def plane_memory(job: Multistability) -> int:
    """Bytes of memory of an answer about a plane or a line of it."""
    _, omegas, gammas = job.spec.shape
    flights = gammas * MAX_ATTRACTORS * job.spec.keep
    return BASE_MEMORY + min(omegas * gammas, MAX_CELLS) * _PER_CELL + flights * _PER_FLIGHT


def flights(job: Multistability, xi: float | None, omega: float) -> NDArray[np.float64]:
    """The stored flights (gamma, attractor, flight), rad, of the line nearest to (xi, omega)."""
    at = {axis: nearest_index(job.spec, axis, value).index for axis, value in (("xi", xi), ("omega", omega))}
    return _read(job, ("flight_time",), **at)["flight_time"]


def _read(job: Multistability, names: Sequence[str], **at: int) -> dict[str, NDArray[Any]]:
    # Before there is a store, no cell has an attractor.
    shape = tuple(
        n for axis, n in zip(("xi", "omega", "gamma"), job.spec.shape, strict=True) if axis not in at
    )
    extra = {"outcome": (), "attractor_count": (), "flight_time": (0, 0)}
    return read_stored(
        job, names, at, lambda: {name: np.zeros((*shape, *extra.get(name, (0,)))) for name in names}
    )


def _known(arrays: _Arrays, i: int, j: int) -> range:
    """Indices of the stored attractors of a cell."""
    stored: int = arrays["attractor_outcome"].shape[-1]
    return range(min(int(arrays["attractor_count"][i, j]), stored))


def _ids(arrays: _Arrays) -> NDArray[np.int64]:
    """The id of every stored attractor (omega, gamma, id); 0 where there is none."""
    branch = _branches(arrays)
    owner = _joined(branch, _votes(arrays, branch))
    there = branch >= 0
    owners, index, cells = np.unique(owner[branch[there]], return_inverse=True, return_counts=True)
    order = np.lexsort((owners, -cells))
    number = np.empty(len(owners), np.int64)
    number[order] = np.arange(1, len(owners) + 1)
    ids = np.zeros(branch.shape, np.int64)
    ids[there] = number[index]
    return ids


def _joined(branch: NDArray[np.int64], votes: Mapping[tuple[int, int], int]) -> NDArray[np.int64]:
    """Of each branch, the first branch of its attractor. Pairs join by votes, unless they share a cell."""
    cells: list[set[int]] = [set() for _ in range(int(branch.max(initial=-1)) + 1)]
    members = [[number] for number in range(len(cells))]
    owner = np.arange(len(cells))
    stored = branch.shape[2]
    for at, number in enumerate(branch.ravel().tolist()):
        if number >= 0:
            cells[number].add(at // stored)
    for pair, _ in sorted(votes.items(), key=lambda vote: (-vote[1], vote[0])):
        first, second = sorted(int(owner[number]) for number in pair)
        if first != second and cells[first].isdisjoint(cells[second]):
            owner[members[second]] = first
            members[first] += members[second]
            cells[first] |= cells[second]
    return owner


def _branches(arrays: _Arrays) -> NDArray[np.int64]:
    """The branch of every stored attractor (omega, gamma, id), numbered line by line; -1: none."""
    branch = np.full(arrays["attractor_outcome"].shape, -1, np.int64)
    branches = 0
    omegas, gammas = arrays["outcome"].shape
    for i in range(omegas):
        for j in range(gammas):
            for k in _known(arrays, i, j):
                before = int(arrays["next_down"][i, j, k]) - 1 if j else -1
                if before >= 0 and arrays["next_up"][i, j - 1, before] == k + 1:
                    branch[i, j, k] = branch[i, j - 1, before]
                else:
                    branch[i, j, k] = branches
                    branches += 1
    return branch


def _votes(arrays: _Arrays, branch: NDArray[np.int64]) -> Mapping[tuple[int, int], int]:
    """In how many cells branches of neighbouring lines are nearest to each other."""
    votes: Counter[tuple[int, int]] = Counter()
    for i in range(1, len(branch)):
        for j in range(branch.shape[1]):
            for k, before in _nearest(arrays, i, j):
                votes[int(branch[i - 1, j, before]), int(branch[i, j, k])] += 1
    return votes


def _nearest(arrays: _Arrays, i: int, j: int) -> Iterator[tuple[int, int]]:
    """Pairs of attractors of the cells (i, j) and (i - 1, j): of one mode, the nearest flights first."""
    longest = arrays["longest_flight"]
    pairs = sorted(
        (abs(float(longest[i, j, k] - longest[i - 1, j, before])), k, before)
        for k in _known(arrays, i, j)
        for before in _known(arrays, i - 1, j)
        if _mode(arrays, i, j, k) == _mode(arrays, i - 1, j, before)
    )
    here, there = set[int](), set[int]()
    for difference, k, before in pairs:
        near = difference <= NEAR or arrays["attractor_outcome"][i, j, k] == Outcome.APERIODIC
        if near and k not in here and before not in there:
            here.add(k)
            there.add(before)
            yield k, before


def _mode(arrays: _Arrays, i: int, j: int, k: int) -> _Mode:
    outcome, bounces, periods = (
        int(arrays[name][i, j, k]) for name in ("attractor_outcome", "bounces", "periods")
    )
    return outcome, bounces, periods


def _places(arrays: _Arrays, ids: NDArray[np.int64], i: int, j: int) -> tuple[Place, ...]:
    return tuple(
        Place(
            int(ids[i, j, k]),
            attractor_label(*_mode(arrays, i, j, k)),
            float(arrays["fraction"][i, j, k]),
            float(arrays["longest_flight"][i, j, k]),
        )
        for k in _known(arrays, i, j)
    )


def _attractors(
    cells: Sequence[Sequence[Sequence[Place]]], omega: NDArray[np.float64], gamma: NDArray[np.float64]
) -> Iterator[Attractor]:
    """The attractors of the plane by id."""
    found: dict[int, list[tuple[float, float, Place]]] = {}
    for i, line in enumerate(cells):
        for j, cell in enumerate(line):
            for place in cell:
                found.setdefault(place.id, []).append((float(omega[i]), float(gamma[j]), place))
    for number, places in sorted(found.items()):
        omegas, gammas, here = zip(*places, strict=True)
        labels = Counter(place.label for place in here)
        longest = [place.longest_flight for place in here]
        yield Attractor(
            number, min(labels, key=lambda label: (-labels[label], label)), len(here),
            (min(gammas), max(gammas)), (min(omegas), max(omegas)), (min(longest), max(longest)),
        )  # fmt: skip


def _events(
    cells: Sequence[Sequence[Sequence[Place]]],
    computed: NDArray[np.bool_],
    arrays: _Arrays,
    ids: NDArray[np.int64],
    omega: NDArray[np.float64],
    gamma: NDArray[np.float64],
) -> Iterator[Event]:
    """Births, deaths and changes of mode, between computed cells."""
    for i, line in enumerate(cells):
        for j in range(len(line) - 1):
            if not computed[i, j] or not computed[i, j + 1]:
                continue
            below, above = ({place.id: place.label for place in cell} for cell in line[j : j + 2])
            where = (float(omega[i]), float(gamma[j]), float(gamma[j + 1]))
            for number in sorted(below.keys() | above.keys()):
                labels = below.get(number), above.get(number)
                if labels[0] == labels[1]:
                    continue
                if labels[0] is None:
                    leads_to = _target(arrays["next_down"], ids, (i, j + 1), number, (i, j))
                    yield Event("birth", number, *where, *labels, leads_to)
                elif labels[1] is None:
                    leads_to = _target(arrays["next_up"], ids, (i, j), number, (i, j + 1))
                    yield Event("death", number, *where, *labels, leads_to)
                else:
                    yield Event("mode", number, *where, *labels, None)


def _target(
    leads: NDArray[np.int8], ids: NDArray[np.int64], cell: tuple[int, int], number: int, to: tuple[int, int]
) -> int | None:
    """The id of the attractor of the cell `to` that attractor `number` of `cell` leads to."""
    k = int(np.flatnonzero(ids[cell] == number)[0])
    reached = int(leads[cell][k])
    return int(ids[to][reached - 1]) if reached > 0 else None
