"""Branches of a spring's cycles on the contact of a specification, and curves of their events."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any, Final, NamedTuple

import numpy as np

from kernel.cycles.any_contact import (
    both_ways,
    branches,
    branches_at,
    cut_off,
    cycles_at_cell,
    event_record,
    is_doubled,
    joined,
    joins,
    lies_on,
    record,
    turned,
    up_to_shorter,
)
from kernel.cycles.changes import doubled
from kernel.cycles.curves import Curves, Parameter
from kernel.cycles.cycles import Cycles, Point, admissible, cycle_from, cycle_through
from kernel.cycles.events import Branch, Events, Kind
from kernel.cycles.follow import RANGE, End, Event, Followed, ahead, crossing, follow, happens
from kernel.cycles.roots import Floats
from kernel.params import Cell, Outcome
from worker import store
from worker.analysis.bisection import BOUNCING
from worker.spec.contact_models import Contact, Rigid, Soft
from worker.study.layout import CELL_DIMS
from worker.sweep import AXES, SweepSpec
from worker.sweep.task import run_cells
from worker.work import plate_at

#: Flights longer than this, rad, count as bounces.
MICRO_FLIGHT: Final[float] = SweepSpec.model_fields["micro_flight"].default

#: Core-seconds of a cycle on a branch; cycles with many hops take most.
CYCLE_SECONDS: Final = 2e-3

#: Limits on the branches followed per line of cells, on the plate periods of their cycles, and on the points
#: of a branch in each direction.
MAX_BRANCHES: Final = 12
MAX_PERIODS: Final = 16
POINTS: Final = 400

#: Settled cells of lowest Gamma in a line whose cycles are followed to their ends.
LOWEST: Final = 3

#: Kinds of events whose curves are followed for any contact.
CONTACT_CURVES: Final = (Kind.FOLD, Kind.FLIP)
#: Values of the parameter at which curves are sought, steps over its range, and the smallest part of a step.
SECTIONS: Final = 5
STEPS: Final = 60
_LEAST_STEP: Final = 0.05
#: A step that is more than this part of the way to the next section ends there.
_REACHES: Final = 0.999
#: Most core-seconds of the curves of a mode up to a restitution of 1 - _BOUNCY. Beyond it they grow as the
#: number of hops after a landing, 1/(1 - restitution).
_CURVES_SECONDS, _BOUNCY = 6.0, 0.3
#: The secant rule: its first step along a branch, its last, and the limit on steps.
_SECANT, _LOCATED, _SECANTS = 1e-4, 1e-11, 40
#: A zero farther along a branch is another event.
_FAR: Final = 0.2
#: Events at one value of the parameter are the same within this, in Gamma and rad.
_SAME_EVENT: Final = 1e-6
#: An event with other segments is sought within the first of its Gamma, relative; it lies within the second.
_NEAR_CURVE, _ON_CURVE = 1e-2, 1e-4
#: Points each way within which the segments of a cycle change beside an event that is lost.
_BESIDE: Final = 40


class Skipped(NamedTuple):
    """A settled cell from which no branch was followed."""

    cell: Cell
    bounces: int
    periods: int
    reason: str


class FollowedCycles(NamedTuple):
    """Branches, and the events on each of them."""

    branches: tuple[Branch, ...]
    events: tuple[Events, ...]
    skipped: tuple[Skipped, ...] = ()


def follow_cycles(
    contact: Contact, cell: Cell, periods: int, along: str, span: tuple[float, float], points: int,
    twice: bool,
) -> FollowedCycles:  # fmt: skip
    """The branches along an axis within `span` from the cycles (1, periods), at most `points` each way.

    Those along "omega" or "xi" pass through the cycles of the cell. twice: with the branches of twice the
    period, and with all flights of each cycle. Runs on workers, which compile for it. Raises
    KernelInputError.
    """
    plate = plate_at(contact, *cell)
    if along == "gamma":
        lines = branches(plate, cell.omega, cell.xi, periods, span=span, points=points)
    else:
        lines = branches_at(plate, cell, periods, along, span, points=points)
    return _recorded(lines, span, points, twice, flights=twice)


def _doubled(lines: list[Followed], span: tuple[float, float], points: int) -> list[Followed]:
    """The branches of twice the period that begin at flips, without known ones: at most MAX_BRANCHES."""
    new: list[Followed] = []
    for flip in (event.point for line in lines for event in line.events if event.kind is Kind.FLIP):
        first = doubled(flip) if len(new) < MAX_BRANCHES else None
        if first is None or any(lies_on(first, line) for line in lines + new):
            continue
        line = up_to_shorter(follow(first, 0.0, points=points, span=span))
        # near the flip the two branches are too close to tell apart
        middle = line.points[len(line.points) // 2]
        if not any(lies_on(middle, other) for other in lines + new):
            new.append(line)
    return new


def _recorded(
    lines: list[Followed], span: tuple[float, float], points: int, twice: bool, *, flights: bool,
    micro_flight: float = MICRO_FLIGHT, skipped: Sequence[Skipped] = (),
) -> FollowedCycles:  # fmt: skip
    """The record of branches, and if `twice` of those of twice the period.

    flights: whether their `flight_time` is that of `_longest_first`.
    """
    if twice:
        lines = lines + _doubled(lines, span, points)
    records = [record(line.points, micro_flight) for line in lines]
    if flights:
        tables = (_longest_first(line.points, micro_flight) for line in lines)
        records = [branch._replace(flight_time=t) for branch, t in zip(records, tables, strict=True)]
    events = tuple(event_record(line.events, micro_flight) for line in joined(lines))
    return FollowedCycles(tuple(records), events, tuple(skipped))


def follow_cells(
    spec: SweepSpec, url: str, along: str, lines: tuple[tuple[int, int, int], ...],
    span: tuple[float, float], complete: bool, twice: bool,
) -> FollowedCycles:  # fmt: skip
    """The branches within `span` of the cycles to which the cells of lines `along` an axis settled.

    lines: as of `settled_cells`, of one or both directions. Each cycle has all flights that count, the
    longest first. The shortest cycles are followed first. A cell whose cycle lies on a followed branch is
    left out. Raises a `store.StoreError`.
    """
    kept: list[Followed] = []
    skipped: list[Skipped] = []
    cells = (cell for line in lines for cell in settled_cells(spec, url, along, line, complete))
    inside = [settled for settled in cells if span[0] <= getattr(settled.cell, along) <= span[1]]
    for settled in sorted(inside, key=lambda settled: settled.periods):
        if settled.periods > MAX_PERIODS:
            skipped.append(settled.skipped(f"cycles of up to {MAX_PERIODS} plate periods are followed"))
            continue
        seed = settled.cycle(spec, along)
        if seed is None:
            skipped.append(settled.skipped("no cycle was found beside its state"))
        elif any(lies_on(seed, line) for line in kept):
            continue
        elif len(kept) == MAX_BRANCHES:
            skipped.append(settled.skipped(f"{MAX_BRANCHES} branches were followed before it, the limit"))
        else:
            kept.append(both_ways(seed, span, POINTS, partial(joins, kept)))
    return _recorded(kept, span, POINTS, twice, flights=True, micro_flight=spec.micro_flight, skipped=skipped)


def own_cycle(
    contact: Contact, cell: Cell, periods: int, state: Floats | None, flight_time: float | None
) -> tuple[Branch, Floats] | None:
    """The cycle of a contact at a cell, as a branch of one point, with the state (6,) at its beginning.

    It goes through a state that branches have, or else its longest flight is nearest to flight_time, rad.
    None if the branches of `follow_cycles` have no such cycle. Raises KernelInputError.
    """
    plate = plate_at(contact, *cell)
    point = None if state is None else cycle_through(plate, cell, periods, state)
    if point is None and flight_time is not None:
        cycles = cycles_at_cell(plate, cell, periods)
        point = min(cycles, key=lambda cycle: abs(max(cycle.flights) - flight_time), default=None)
    return None if point is None else (record([point], MICRO_FLIGHT), point.state)


class Settled(NamedTuple):
    """A periodic cell of a sweep."""

    cell: Cell
    bounces: int
    periods: int
    state: Floats | None  # (6,) at its end; None: the cell began at rest, and its state is not stored

    def cycle(self, spec: SweepSpec, along: str = "gamma") -> Point | None:
        """The cycle near the cell's state on its branch, or None. A cell from rest is computed again."""
        cells = [np.full(1, value) for value in self.cell]
        state = run_cells(spec, cells, None).end_state[0] if self.state is None else self.state
        cycle = cycle_from(plate_at(spec.model.exact, *self.cell), self.cell, self.periods, state)
        return cycle if cycle is None or along == "gamma" else turned(cycle, along, self.cell.gamma)

    def skipped(self, reason: str) -> Skipped:
        return Skipped(self.cell, self.bounces, self.periods, reason)


def settled_cells(
    spec: SweepSpec, url: str, along: str, line: tuple[int, int, int], complete: bool
) -> list[Settled]:
    """The periodic cells along an axis. Raises a `store.StoreError`.

    line: indices of the other CELL_DIMS, in their order: along gamma (direction, xi, omega).
    """
    names = ["flights", "bounces", "periods", "outcome", *(["end_state"] if spec.ramp_axis else [])]
    where: dict[str, Any] = dict(zip((dim for dim in CELL_DIMS if dim != along), line, strict=True))
    arrays = store.read_slice(url, names, complete=complete, **where)
    fixed = {axis: float(spec.axis_values(axis)[where[axis]]) for axis in AXES if axis != along}
    values = spec.axis_values(along).tolist()
    # a cell filled in from another has no flights
    return [
        Settled(
            Cell(**fixed, **{along: values[i]}), int(arrays["bounces"][i]), int(arrays["periods"][i]),
            arrays["end_state"][i] if spec.ramp_axis else None,
        )
        for i in np.flatnonzero((arrays["outcome"] == Outcome.PERIODIC) & (arrays["flights"] > 0))
    ]  # fmt: skip


def lowest_cells(
    spec: SweepSpec, url: str, line: tuple[int, int, int], complete: bool
) -> tuple[list[Settled], float]:
    """Up to LOWEST periodic cells of lowest Gamma, and the lowest Gamma that bounces, infinite if none does.

    line: indices (direction, xi, omega). Raises a `store.StoreError`.
    """
    direction, xi, omega = line
    outcome = store.read_slice(url, ["outcome"], direction=direction, xi=xi, omega=omega, complete=complete)
    bouncing = spec.axis_values("gamma")[np.isin(outcome["outcome"], BOUNCING)]
    cells = settled_cells(spec, url, "gamma", line, complete)[:LOWEST]
    return cells, float(bouncing.min()) if len(bouncing) else math.inf


def _longest_first(points: list[Point], micro_flight: float) -> Floats:
    """The flights of each cycle that count, at least one, longest first: (n, flights), rad; NaN beyond."""
    flights = [sorted(point.flights, reverse=True) for point in points]
    counted = [[t for t in times if t > micro_flight] or times[:1] for times in flights]
    return np.array(list(zip_longest(*counted, fillvalue=np.nan))).T


def curves_seconds(contact: Rigid | Soft) -> float:
    """Most core-seconds of `follow_curves` for a mode."""
    return _CURVES_SECONDS * max(1.0, _BOUNCY / (1.0 - contact.restitution))


def follow_curves(
    contact: Contact, along: Parameter, fixed: float, span: tuple[float, float], periods: int,
    kinds: tuple[Kind, ...], gamma_max: float,
) -> Curves:  # fmt: skip
    """Curves of the events on a contact's branches over `along` in `span`, the other parameter at `fixed`.

    Events on branches along Gamma are followed both ways in small steps, up to cusps and as long as their
    cycle is admissible. Finds every curve that crosses one of SECTIONS evenly spaced values, but for those
    beyond the points, where branches are cut off. Raises KernelInputError.
    """
    curves: list[list[Event]] = []
    cut: list[Event] = []
    sections = np.linspace(*span, SECTIONS).tolist()
    for value in sections:
        omega, xi = (value, fixed) if along is Parameter.OMEGA else (fixed, value)
        plate = plate_at(contact, gamma_max, omega, xi)
        lines = branches(plate, omega, xi, periods, span=(RANGE[0], gamma_max))
        cut += cut_off(lines)
        for line in lines:
            for event in line.events:
                if event.kind not in kinds or is_doubled(event.point):
                    continue
                if not any(_lies_on_curve(event, curve, along) for curve in curves):
                    step = (span[1] - span[0]) / STEPS
                    ways = (-step, sections[::-1]), (step, sections)
                    down, up = (list(_along(event, along, *way)) for way in ways)
                    curves.append([*down[::-1], event, *up])
    *records, points = (event_record(events, MICRO_FLIGHT) for events in (*curves, cut))
    return Curves(tuple(records), points)


def _along(event: Event, along: Parameter, step: float, stops: list[float]) -> Iterator[Event]:
    """The same event at further values of a parameter, `step` apart, or less to keep it.

    stops: values in the direction of the step, at which curves have a point; the last ends them.
    """
    largest = abs(step)
    last, slope, changed = event.point, np.zeros_like(event.point.x), False  # slope: by the parameter
    for stop in stops:
        while (stop - (begin := getattr(last.cycles, along))) * step > 0.0:
            value = begin + step if abs(step) < _REACHES * abs(stop - begin) else stop
            step, omega = value - begin, along is Parameter.OMEGA
            cycles = last.cycles._replace(omega=value) if omega else last.cycles._replace(xi=value)
            x = last.x + step * slope
            point = _event_at(cycles, x, last.tangent, event.kind)
            if point is None and abs(step) > largest * _LEAST_STEP:
                step *= 0.5
                continue
            if point is None and not changed:
                point = _with_other_segments(cycles, last, event.kind, cycles.parameter(x))
            if point is None:
                return
            yield Event(event.kind, point)
            changed = point.letters != last.letters
            slope = np.zeros_like(point.x) if changed else (point.x - last.x) / step
            step, last = math.copysign(min(2.0 * abs(step), largest), step), point


def _with_other_segments(cycles: Cycles, last: Point, kind: Kind | End, gamma: float) -> Point | None:
    """The event at about `gamma` of a spring next to that of `last`, with other segments; None if none is."""
    near = (1.0 - _NEAR_CURVE) * gamma, (1.0 + _NEAR_CURVE) * gamma
    for way in (1.0, -1.0):
        points = follow(last, way, points=_BESIDE, span=near, crossings=()).points
        other = next((point for point in points if point.letters != last.letters), None)
        if other is not None:
            same = other.cycles._replace(omega=cycles.omega, xi=cycles.xi)
            point = _event_at(same, other.x, other.tangent, kind)
            if point is not None and abs(point.parameter - gamma) < _ON_CURVE:
                return point
    return None


def _event_at(cycles: Cycles, x: Floats, tangent: Floats, kind: Kind | End) -> Point | None:
    """The event of a kind on the branch near x (m,), by the secant rule; None without an admissible one."""
    node = cycles.newton(x, tangent)
    if node is None:
        return None
    kind = Kind(kind)
    a, b = 0.0, _SECANT
    value_a, point = _test(kind, node), ahead(node, b)
    for _ in range(_SECANTS):
        if point is None:
            return None
        value = _test(kind, point)
        if abs(value - value_a) == 0.0 or abs(b - a) < _LOCATED:
            break
        a, value_a, b = b, value, b - value * (b - a) / (value - value_a)
        if not abs(b) < _FAR:
            return None
        point = ahead(node, b)
    else:  # beyond where two flips meet, the multipliers have a least distance to -1
        return None
    return admissible(point) if happens(kind, point) else None


@np.errstate(divide="ignore", invalid="ignore")
def _test(kind: Kind, point: Point) -> float:
    """A function that is zero at an event of a kind; that of a fold is not where a segment vanishes."""
    return crossing(kind, point) / (point.times.min() if kind is Kind.FOLD else 1.0)


def _lies_on_curve(event: Event, curve: list[Event], along: Parameter) -> bool:
    """Whether a curve passes through an event; it has a point there."""
    value, gamma, flight = _place(event, along)
    places = (_place(other, along) for other in curve if other.kind is event.kind)
    return any(x == value and max(abs(y - gamma), abs(t - flight)) < _SAME_EVENT for x, y, t in places)


def _place(event: Event, along: Parameter) -> tuple[float, float, float]:
    return getattr(event.point.cycles, along), event.point.parameter, max(event.point.flights)
