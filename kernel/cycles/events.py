"""Branches of cycles with one flight in k plate periods, and where they turn, lose stability or end."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from kernel.cycles.admissibility import (
    Check,
    Condition,
    Samples,
    check,
    combination,
    force_at_landing,
    force_slope,
    force_terms,
    gap_terms,
)
from kernel.cycles.closed_form import TWO_PI, Orbit, floquet, multipliers, orbit, stable
from kernel.cycles.roots import Floats, Ints, Roots, roots
from kernel.cycles.spring import STEP, Spring, spring
from kernel.params import LARGEST, KernelInputError

#: Fewest points of a branch.
POINTS: Final = 400

#: Fewest samples of a flight or contact.
SAMPLES: Final = 64

#: Limit on the points of a branch: enough for (1,1) down to Omega = 0.004.
MAX_POINTS: Final = 20_000

#: Largest rate * spacing of the grid. The error of a cubic between neighbours is then 0.2**4/384 = 4e-6.
_RESOLUTION: Final = 0.2

#: The same for samples of a flight or contact, error 2e-4: minima near zero are refined anyway.
_SAMPLED: Final = 0.5

#: Spacing over distance from the ends, where the motion of a stiff dashpot decays within a few points.
_GRADING: Final = 0.1

#: Halvings of a bracket in which Newton's method finds no graze, and Newton steps after each.
_ROUNDS: Final = 12
_STEPS: Final = 8
#: After this many steps Newton's method must stay within a width of its bracket.
_FIRST_STEPS: Final = 3

#: Distance from a pole, or from an event at an end of a flight or contact, at which grazes are sought, rad.
_NEXT: Final = 1e-7

#: Rounding breaks one condition of a grazing orbit by less than this, in plate amplitudes or m A omega**2.
GRAZES: Final = 1e-9

#: An orbit above this Gamma is a pole of the closed form.
_POLE: Final = 1e8


class _Brackets(NamedTuple):
    """Pairs of flight times (m,), rad, between which a condition begins or ceases to hold."""

    broken: Floats  # where it is broken
    holds: Floats  # where it holds
    time: Floats  # rad, of the deepest minimum at `broken`


class Kind(StrEnum):
    """The kind of an event on a branch."""

    FOLD = "fold"  # a multiplier is 1: the branch turns back
    FLIP = "flip"  # a multiplier is -1: the period doubles
    NEIMARK_SACKER = "neimark-sacker"  # a pair leaves the unit circle: a torus
    IMMEDIATE_TAKEOFF = "immediate-takeoff"  # n = 0 at landing: beyond, it takes off at once
    GRAZE_FLIGHT = "graze-flight"  # the gap touches zero within the flight, or at landing
    GRAZE_CONTACT = "graze-contact"  # n touches zero within the contact, or at take-off
    CUSP = "cusp"  # two folds meet
    BOGDANOV_TAKENS = "bogdanov-takens"  # both multipliers are 1
    FOLD_FLIP = "fold-flip"  # multipliers 1 and -1


class Branch(NamedTuple):
    """n cycles in order along their branch, in closed form by flight time.

    Fields of a flight belong to the longest of the cycle. Lengths are in plate amplitudes, velocities in
    plate amplitudes per rad.
    """

    periods: int
    omega: Floats  # (n,)
    xi: Floats  # (n,)
    gamma: Floats  # (n,)
    flights: NDArray[np.int32]  # (n,) of a cycle
    bounces: NDArray[np.int32]  # (n,) flights long enough to count
    flight_time: Floats  # (n,) rad
    takeoff_phase: Floats  # (n,) rad, in [0, 2 pi)
    elongation: Floats  # (n,) at take-off
    elongation_velocity: Floats  # (n,) at take-off
    impact_velocity: Floats  # (n,) gap' before landing, < 0
    multiplier: NDArray[np.complex128]  # (n, 2) of one cycle, the largest first
    stable: NDArray[np.bool_]  # (n,) all inside the unit circle
    violations: NDArray[np.uint8]  # (n,) 0: a cycle of the spring; or the bits of a Reason
    cycle_state: Floats | None = None  # (n, 6) on each cycle, as STATE_FIELDS; None in closed form


class Events(NamedTuple):
    """m events by kind and flight time, with the cycles at which they happen."""

    kind: NDArray[np.str_]  # (m,) a Kind
    omega: Floats  # (m,)
    xi: Floats  # (m,)
    bounces: NDArray[np.int32]  # (m,)
    periods: NDArray[np.int32]  # (m,)
    flight_time: Floats  # (m,) rad
    gamma: Floats  # (m,)
    multiplier: NDArray[np.complex128]  # (m, 2)
    violations: NDArray[np.uint8]  # (m,) 0, or the bits of a Reason; an orbit that grazes is admissible


Record = TypeVar("Record", bound=NamedTuple)

#: Kinds at which a multiplier crosses the unit circle. They depend on the flight time alone.
CROSSINGS: Final = (Kind.FOLD, Kind.FLIP, Kind.NEIMARK_SACKER)

#: Kinds at which an orbit stops being admissible.
EDGES: Final = (Kind.IMMEDIATE_TAKEOFF, Kind.GRAZE_FLIGHT, Kind.GRAZE_CONTACT)

#: The kinds along a branch, in the order of `_tests`.
KINDS: Final = (*CROSSINGS, *EDGES)

#: The index of the function that follows in `_tests`: it is zero where Gamma is infinite.
_POLES: Final = len(KINDS)


def check_spring(omega: float, xi: float, periods: int) -> None:
    """Raise KernelInputError for a spring or a number of plate periods without a branch."""
    if not 1.0 / LARGEST <= omega <= LARGEST:
        raise KernelInputError("omega", f"must be from {1.0 / LARGEST:g} to {LARGEST:g}, got {omega}")
    if not 0.0 <= xi <= LARGEST:
        raise KernelInputError("xi", f"must be from 0 to {LARGEST:g}, got {xi}")
    if periods < 1:
        raise KernelInputError("periods", f"must be >= 1, got {periods}")
    if omega == 1.0 and xi == 0.0:
        raise KernelInputError("xi", "must be > 0 at omega = 1: the driven amplitude is infinite")


def flight_times(
    omega: float, xi: float, periods: int, points: int = POINTS, resolution: float = _RESOLUTION,
    most: int = MAX_POINTS,
) -> Floats:  # fmt: skip
    """A grid (n,) of flight times in (0, 2 pi periods), rad, with n >= points, that resolves the branch.

    The spacing is at most 2 pi periods/points, and `resolution` over the sum of the frequencies of the plate,
    of the flight and of the contact. It is finer near both ends if the dashpot relaxes faster. Raises
    KernelInputError if even spacing takes more than `most` points.
    """
    check_spring(omega, xi, periods)
    b, w = 2.0 * xi / omega, 1.0 / omega**2
    rate = 1.0 + np.sqrt(max(2.0 * w - b * b, 0.0)) + np.sqrt(max(w - 0.25 * b * b, 0.0))
    whole = TWO_PI * periods
    h = min(whole / points, resolution / rate)
    if points > most:
        raise KernelInputError("points", f"must be at most {most:,}, got {points:,}")
    if whole / h > most:
        rule, longest = f"a branch has at most {most:,} points", resolution * most / TWO_PI
        # the frequencies of the spring are as 1/omega; 1 % more, so that the rounded number works
        fitting = 1.01 * omega * (rate - 1.0) / max(longest / periods - 1.0, 1e-300)
        if fitting > LARGEST or longest <= periods:
            fewer = f"must be at most {max(int(longest / rate), 1)} at omega = {omega:g}, got {periods}"
            raise KernelInputError("periods", f"{fewer}: {rule}")
        larger = f"must be at least about {fitting:.3g} for cycles of {periods} plate periods, got {omega:g}"
        raise KernelInputError("omega", f"{larger}: {rule}")
    fastest = b + np.sqrt(max(b * b - 2.0 * w, 0.0))
    finest = min(h, resolution / max(fastest, 1e-300))
    steps = [finest]
    reach = finest
    while (step := max(finest, _GRADING * reach)) < h:
        reach += step
        steps.append(step)
    edge = np.cumsum(steps)
    inner = np.linspace(reach, whole - reach, max(points, int(np.ceil((whole - 2.0 * reach) / h)) + 1))
    first = finest * np.array([0.02, 0.2])
    ends = np.concatenate([first, edge[:-1]])
    return np.concatenate([ends, inner, whole - ends[::-1]])


def branch(omega: float, xi: float, periods: int, flight_time: Floats, tolerance: float = 0.0) -> Branch:
    """The cycles of one flight in `periods` plate periods whose flights take flight_time (n,) rad.

    tolerance: as in `admissibility.check`; `GRAZES` for orbits that graze. Raises KernelInputError.
    """
    check_spring(omega, xi, periods)
    k = spring(omega, xi)
    x = orbit(k, periods, flight_time)
    checked = check(k, periods, flight_time, x, sampled(k, periods), tolerance)
    return _branch(k, periods, flight_time, x, checked.reason)


def branch_and_events(omega: float, xi: float, periods: int, points: int = POINTS) -> tuple[Branch, Events]:
    """The whole branch (1, periods) on a grid of at least `points`, and all its events.

    Raises KernelInputError, as `flight_times` does.
    """
    t = flight_times(omega, xi, periods, points)
    k = spring(omega, xi)
    with np.errstate(all="ignore"):  # poles of Gamma(T)
        value, slope, x = _tests(k, periods, t)
        nodes = sampled(k, periods)
        checked = check(k, periods, t, x, nodes)
        zeros = roots(lambda times: _tests(k, periods, times)[:2], t, value, slope)
        grazes = _grazes(k, periods, t, checked, nodes, zeros.x[zeros.which >= len(CROSSINGS)])
        f = floquet(k, periods, zeros.x)
        happens = (zeros.which != KINDS.index(Kind.NEIMARK_SACKER)) | (np.abs(f.trace) < 2.0)
        happens &= zeros.which != _POLES
        if xi == 0.0:  # the impact only touches zero, where n is zero at landing
            happens &= zeros.which != KINDS.index(Kind.GRAZE_FLIGHT)
        which = np.concatenate([zeros.which[happens], grazes.which])
        events = _events(k, periods, which, np.concatenate([zeros.x[happens], grazes.x]), nodes)
        return _branch(k, periods, t, x, checked.reason), events


def fold_events(omega: float, xi: float, periods: int, below: float) -> Events:
    """The folds of the branch (1, periods) below a Gamma, and no more of it. Raises KernelInputError."""
    t = flight_times(omega, xi, periods)
    k = spring(omega, xi)

    def folds(times: Floats) -> tuple[Floats, Floats]:
        f = floquet(k, periods, times)
        return np.array([1.0 - f.trace + f.det]), np.array([f.det1 - f.trace1])

    with np.errstate(all="ignore"):
        times = roots(folds, t, *folds(t)).x
        x = orbit(k, periods, times)
        times = times[np.hypot(x.c, x.s) < below]
        if not len(times):
            return join_events([])
        which = np.full(len(times), KINDS.index(Kind.FOLD))
        return _events(k, periods, which, times, sampled(k, periods))


def rows_of(record: Record, which: Any) -> Record:
    """The rows of a record that `which` selects: anything that indexes its arrays."""
    fields = record._asdict()
    arrays: Any = {name: values[which] for name, values in fields.items() if isinstance(values, np.ndarray)}
    return record._replace(**arrays)


def join_events(parts: Sequence[Events]) -> Events:
    """The events of all parts, in order."""
    empty = Events(
        np.empty(0, np.str_), np.empty(0), np.empty(0), np.empty(0, np.int32), np.empty(0, np.int32),
        np.empty(0), np.empty(0), np.empty((0, 2), np.complex128), np.empty(0, np.uint8),
    )  # fmt: skip
    return Events(*(np.concatenate(fields) for fields in zip(empty, *parts, strict=True)))


def events_of(kind: Sequence[str], cycles: Branch) -> Events:
    """The record of events, given their kinds (m,) and the cycles (m,) at which they happen."""
    shared = (getattr(cycles, name) for name in Events._fields[5:])
    periods = np.full(len(kind), cycles.periods, np.int32)
    return Events(np.array(kind, np.str_), cycles.omega, cycles.xi, cycles.bounces, periods, *shared)


def sampled(k: Spring, periods: int) -> Samples:
    """Sample times of gap and n, and the terms of both there; as fine as a flight and a contact need.

    Each of the first times is about twice the one before: the gap begins as the cube of the time, and may dip
    early if n' is nearly zero at take-off.
    """
    t = flight_times(float(np.real(k.omega)), float(np.real(k.xi)), periods, SAMPLES, _SAMPLED)
    t = np.sort([0.0, *t, 2.0 * t[0], 4.0 * t[0], 2.0 * t[1]])
    return Samples(t, gap_terms(k, t)[:2], force_terms(k, t)[:2])


def _branch(k: Spring, periods: int, t: Floats, x: Orbit, violations: NDArray[np.uint8]) -> Branch:
    """The record of orbits with flights of t rad (n,)."""
    gamma, one = np.hypot(x.c, x.s), np.ones(len(t), np.int32)
    f = floquet(k, periods, t)
    return Branch(
        periods=periods,
        omega=np.full(len(t), np.real(k.omega)),
        xi=np.full(len(t), np.real(k.xi)),
        gamma=gamma,
        flights=one,
        bounces=one,
        flight_time=t,
        takeoff_phase=np.mod(np.arctan2(x.s, x.c), TWO_PI),
        elongation=x.q0 / gamma,
        elongation_velocity=x.v0 / gamma,
        impact_velocity=x.impact / gamma,
        multiplier=multipliers(f.trace, f.det),
        stable=stable(f.trace, f.det),
        violations=violations,
    )


def _events(k: Spring, periods: int, which: Ints, t: Floats, nodes: Samples) -> Events:
    """The record of the events at flight times t (m,), sorted by kind and time, without poles.

    which: indices into KINDS (m,).
    """
    x = orbit(k, periods, t)
    gamma = np.hypot(x.c, x.s)
    keep = np.flatnonzero(gamma < _POLE)
    keep = keep[np.lexsort((t[keep], which[keep]))]
    which, t, x = which[keep], t[keep], Orbit(*(a[keep] for a in x))
    checked = check(k, periods, t, x, nodes, np.where(which < len(CROSSINGS), 0.0, GRAZES))
    return events_of([KINDS[i] for i in which], _branch(k, periods, t, x, checked.reason))


def _tests(k: Spring, periods: int, t: Floats) -> tuple[Floats, Floats, Orbit]:
    """The functions of KINDS and 1/Gamma (7, n), their slopes (7, n), and the orbits.

    The last four have the factor det/|Gamma det|, with det of the orbits' equations, and so no poles.
    """
    f = floquet(k, periods, t)
    z = t + 1j * STEP
    x = orbit(k, periods, z)
    last = np.array([force_at_landing(k, x, z), x.impact, force_slope(k, x), np.ones_like(z)]) * x.det
    # this factor is not differentiated: at a root that does not matter
    last = last / np.hypot((x.c * x.det).real, (x.s * x.det).real)
    value = np.array([1.0 - f.trace + f.det, 1.0 + f.trace + f.det, f.det - 1.0, *last.real])
    slope = np.array([f.det1 - f.trace1, f.det1 + f.trace1, f.det1, *(last.imag / STEP)])
    return value, slope, Orbit(*(a.real for a in x))


def _grazes(k: Spring, periods: int, t: Floats, checked: Check, nodes: Samples, edge: Floats) -> Roots:
    """Flight times at which a minimum of the gap in flight, or of n in contact, passes zero.

    edge: flight times of poles, and of events at which a minimum leaves its flight or contact.
    """
    grazes: list[Roots] = []
    gap, force = _brackets(k, periods, t, checked, np.sort(edge), nodes)
    for kind, contact, brackets in ((Kind.GRAZE_FLIGHT, False, gap), (Kind.GRAZE_CONTACT, True, force)):
        inside = brackets
        for _ in range(_ROUNDS):
            if not len(inside.time):
                break
            root, ok = _touch(k, periods, inside, contact)
            ok &= (root - inside.broken) * (root - inside.holds) <= 0.0
            # at the root of one minimum another may be below zero
            middle = np.where(ok, root, 0.5 * (inside.broken + inside.holds))
            held = check(k, periods, middle, orbit(k, periods, middle), nodes, np.where(ok, GRAZES, 0.0))
            broken, minimum, _ = held.force if contact else held.gap
            ok &= ~broken
            grazes.append(Roots(np.full(np.count_nonzero(ok), KINDS.index(kind)), root[ok]))
            halved = _Brackets(
                np.where(broken, middle, inside.broken), np.where(broken, inside.holds, middle),
                np.where(broken, minimum, inside.time),
            )  # fmt: skip
            inside = rows_of(halved, ~ok)
    none = Roots(np.empty(0, np.intp), np.empty(0))
    return Roots(*map(np.concatenate, zip(none, *grazes, strict=True)))


def _brackets(
    k: Spring, periods: int, t: Floats, checked: Check, edge: Floats, nodes: Samples
) -> tuple[_Brackets, _Brackets]:
    """Brackets of the flight times at which the conditions of flight and contact begin or cease to hold.

    t (n,): increasing. checked: the conditions there. Changes at an edge (m,) are left out. A condition may
    change next to it within less than the grid, so that it is checked on both sides.
    """
    edge = edge[(edge > t[0]) & (edge < t[-1])]
    beside = np.concatenate([edge - _NEXT, edge + _NEXT])
    inner = check(k, periods, beside, orbit(k, periods, beside), nodes)
    times = np.concatenate([t, beside])
    order = np.argsort(times, kind="stable")
    times = times[order]
    held = np.searchsorted(times, edge) - 1

    def between(condition: Condition, beside: Condition) -> _Brackets:
        broken = np.append(condition.broken, beside.broken)[order]
        time = np.append(condition.time, beside.time)[order]
        changes = np.setdiff1d(np.flatnonzero(broken[:-1] != broken[1:]), held)
        first = broken[changes]
        return _Brackets(times[changes + ~first], times[changes + first], time[changes + ~first])

    return between(checked.gap, inner.gap), between(checked.force, inner.force)


def _touch(k: Spring, periods: int, inside: _Brackets, contact: bool) -> tuple[Floats, NDArray[np.bool_]]:
    """Flight times (m,) at which a minimum is zero, by Newton's method from each bracket's broken end.

    Also whether it converged (m,) to a minimum inside the flight or contact.
    """
    t, _, time = inside
    middle, width = 0.5 * (inside.broken + inside.holds), np.abs(inside.broken - inside.holds)
    for number in range(_STEPS):
        z = t + 1j * STEP
        x = orbit(k, periods, z)
        terms, weights, offset = combination(k, x, z, contact)
        f, f1, f2 = (np.einsum("in,in->n", weights, y) for y in terms(k, time))
        f, by_t, f1_by_t = f.real + offset, f.imag / STEP, f1.imag / STEP
        f1, f2 = f1.real, f2.real
        det = by_t * f2 - f1 * f1_by_t
        step, move = (f * f2 - f1 * f1) / det, (by_t * f1 - f1_by_t * f) / det
        t, time = t - step, time - move
        t = np.clip(t, 1e-9, TWO_PI * periods - 1e-9)
        lost = (number >= _FIRST_STEPS) & ~(np.abs(t - middle) < 1.5 * width)
        if ((np.abs(step) < 1e-14 * t) | lost).all():
            break
    end = TWO_PI * periods - t if contact else t
    ok = (np.abs(step) < 1e-12 * t) & (np.abs(move) < 1e-9) & (f2 > 0.0) & (time > 1e-6) & (time < end - 1e-6)
    return t, ok
