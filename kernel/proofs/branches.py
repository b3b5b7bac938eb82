"""Proofs about the branch of cycles (1,k) on an ideal plate with e = 0: folds, flips, Gamma_down.

A cycle of flight time T solves four linear equations in u = (q0, v0, c, s) at take-off (docs/hysteresis.md),
so that Gamma(T), its derivatives and the tangent map are balls for a ball of T.
"""

from collections.abc import Callable
from typing import NamedTuple

from flint import arb, arb_mat, ctx

from kernel.proofs.balls import (
    Condition,
    NotProvenError,
    above,
    around,
    check_positive,
    column,
    entries,
    exact,
    flight_rows,
    flow,
    hull,
    matrix,
    opposite,
    with_enough_bits,
)

#: Newton's steps to a zero, and how far it may leave the start.
_STEPS = 12
_NEAR = 1e-3

#: Flight times beside a fold over which stability is shown in one ball: at most, and at least.
_WIDEST = 1e-4
_NARROWEST = 1e-12

#: The narrowest stretch that is divided in the search for all zeros.
_SHORTEST = 1e-9

#: Of the tangent map's trace and determinant: 1 - tr + det is zero at folds, 1 + tr + det at flips.
FOLDS, FLIPS = 0, 1


class ProvenEvent(NamedTuple):
    """Exactly one fold or flip lies in these balls."""

    flight_time: arb  # rad
    gamma: arb


class ProvenDown(NamedTuple):
    """For every Gamma from `above` to `below`, both included, a stable admissible cycle (1,k) exists."""

    fold: ProvenEvent
    above: arb  # just above the fold's Gamma: bouncing persists here at most
    below: arb


class ProvenBranch:
    """The branch (1, periods) of a spring. Numbers as in `balls.exact`.

    Each method raises `NotProvenError`.
    """

    def __init__(self, omega: float | str, xi: float | str, periods: int = 1) -> None:
        self._given, self._periods = (omega, xi), periods

    def _prepare(self) -> None:
        """The matrices at the present precision."""
        omega, xi = (exact(number) for number in self._given)
        b, w = 2 * xi / omega, 1 / (omega * omega)
        self.whole = 2 * self._periods * arb.pi()
        self._fly = matrix(flight_rows(b, w))
        self._stick = matrix(
            [[0, 1, 0, 0, 0], [-w, -b, 1, 0, -1], [0, 0, 0, -1, 0], [0, 0, 1, 0, 0], [0] * 5]
        )
        self._gap = matrix([[1, 0, 0, 0, 0, 0, 0]])
        self._force_in_flight = matrix([[0, 0, -w, -b, -1, 0, 1]])
        self._force = matrix([[-w, -b, -1, 0, 1]])
        unknown = [[int(i == j) for j in range(4)] for i in range(4)]
        self._unknowns = matrix([[0] * 4, [0] * 4, *unknown, [0] * 4])
        self._constant = matrix([[0]] * 6 + [[1]])
        # a landing: of states, and of variations at fixed phase
        kept = [[int(i == j) for j in range(7)] for i in (4, 5, 6)]
        self._land = matrix([[0, 0, 1, 0, 0, 0, 0], [0, 1, 0, 1, 0, 0, 0], *kept])
        self._land_varied = matrix([[1, 0, 1, 0, 0, 0, 0], [-b, 1, 0, 1, 0, 0, 0], *([0] * 7 for _ in kept)])
        self._spring_stuck = matrix([[1, 0, 0, 0, 0], [0, 1, 0, 0, 0]])
        self._spring = matrix([[0, 0, 1, 0, 0, 0, 0], [0, 0, 0, 1, 0, 0, 0]])

    def fold(self, flight_time: float) -> ProvenEvent:
        """The fold beside a flight time, where dGamma/dT has a simple zero."""
        return self._event(flight_time, lambda t: self._square(t)[1:])

    def flip(self, flight_time: float) -> ProvenEvent:
        """The flip beside a flight time, where a multiplier passes -1."""

        def at(t: arb) -> tuple[arb, arb]:
            value, slope = self._jury(t)
            return value[FLIPS], slope[FLIPS]

        return self._event(flight_time, at)

    def _event(self, flight_time: float, function: Callable[[arb], tuple[arb, arb]]) -> ProvenEvent:
        def prove() -> ProvenEvent:
            self._prepare()
            t = _simple_zero(function, flight_time)
            return ProvenEvent(t, self._gamma(t))

        return with_enough_bits(prove)

    def down(self, flight_time: float) -> ProvenDown:
        """That Gamma_down lies at most just above the fold beside a flight time."""

        def prove() -> ProvenDown:
            self._prepare()
            t = _simple_zero(lambda x: self._square(x)[1:], flight_time)
            if not self._square(t)[2] > 0:
                raise NotProvenError("the fold is no minimum of Gamma")
            side = 1 if self._jury(t)[1][FOLDS] > 0 else -1
            reach, why = _WIDEST, NotProvenError("nothing was tried")
            while reach > _NARROWEST:
                try:
                    low, high = self._stable_beside(t, side, reach)
                    return ProvenDown(ProvenEvent(t, self._gamma(t)), low, high)
                except NotProvenError as failed:
                    why, reach = failed, 0.25 * reach
            raise why

        return with_enough_bits(prove)

    def _stable_beside(self, fold: arb, side: int, reach: float) -> tuple[arb, arb]:
        """The Gamma between which all cycles beside a fold are stable and admissible."""
        near, far = fold.mid() + side * 2 * fold.rad(), fold.mid() + side * arb(reach)
        beside = hull(fold.mid() - side * fold.rad(), far)
        value, slope = self._jury(beside)
        if not (self._square(beside)[2] > 0 and self._square(near)[1] * side > 0):
            raise NotProvenError("Gamma may not grow away from the fold")
        if not (slope[FOLDS] * side > 0 and self._jury(near)[0][FOLDS] > 0):
            raise NotProvenError("1 - tr + det may not grow away from the fold")
        if not (value[1] > 0 and value[2] > 0):
            raise NotProvenError("the other multiplier may not be inside the unit circle")
        self._check_admissible(beside)
        return self._gamma(near).upper(), self._gamma(far).lower()

    def events(self, which: int) -> list[arb]:
        """Every zero of 1 - tr + det (FOLDS) or 1 + tr + det (FLIPS) on [0, 2 pi k], a ball each.

        Folds are among the zeros of the first by the implicit function theorem, so that the list is complete;
        flips beside poles of Gamma count too. In rad, in order.
        """

        def prove() -> list[arb]:
            self._prepare()
            stretches, zeros = [(0.0, above(self.whole))], list[arb]()
            while stretches:
                low, high = stretches.pop()
                if self._no_zero(which, low, high):
                    continue
                t = hull(low, high)
                if self._jury(t)[1][which] != 0:
                    ends = [self._jury(arb(end))[0][which] for end in (low, high)]
                    if opposite(*ends):
                        zeros.append(t)
                        continue
                    if all(end > 0 for end in ends) or all(end < 0 for end in ends):
                        continue
                if high - low < _SHORTEST:
                    raise NotProvenError(f"a zero that may be double, near {low:.9g} rad")
                middle = 0.5 * (low + high)
                stretches += [(middle, high), (low, middle)]
            return zeros

        return with_enough_bits(prove)

    def _no_zero(self, which: int, low: float, high: float) -> bool:
        t = hull(low, high)
        value, slope = (terms[which] for terms in self._jury(t))
        return bool(value != 0) or bool(self._jury(t.mid())[0][which] + slope * (t - t.mid()) != 0)

    # What follows is of a ball of T.

    def _flows(self, t: arb) -> tuple[list[arb_mat], list[arb_mat]]:
        """The flows of flight and contact, with two derivatives by T each."""
        fly, stick = flow(self._fly, t), flow(self._stick, self.whole - t)
        return (
            [fly, self._fly * fly, self._fly * (self._fly * fly)],
            [stick, -1 * (self._stick * stick), self._stick * (self._stick * stick)],
        )

    def _orbit(self, t: arb, derivatives: int = 2) -> list[list[arb]]:
        """u = (q0, v0, c, s) of the cycle of flight time T and its derivatives by T."""
        fly, stick = self._flows(t)
        landed = [self._land * motion for motion in fly]
        whole = [
            stick[0] * landed[0],
            stick[1] * landed[0] + stick[0] * landed[1],
            stick[2] * landed[0] + 2 * (stick[1] * landed[1]) + stick[0] * landed[2],
        ]
        equations, right = [], []
        for order in range(derivatives + 1):
            force = self._force_in_flight if order == 0 else 0 * self._force_in_flight
            back = self._spring_stuck * whole[order]
            back = back - self._spring if order == 0 else back
            rows = matrix([*force.tolist(), *(self._gap * fly[order]).tolist(), *back.tolist()])
            equations.append(rows * self._unknowns)
            right.append(-1 * (rows * self._constant))
        try:
            u = [equations[0].solve(right[0])]
            if derivatives > 0:
                u.append(equations[0].solve(right[1] - equations[1] * u[0]))
            if derivatives > 1:
                u.append(equations[0].solve(right[2] - 2 * (equations[1] * u[1]) - equations[2] * u[0]))
        except ZeroDivisionError:
            raise NotProvenError("the equations of a cycle may be singular") from None
        return [entries(x) for x in u]

    def _square(self, t: arb) -> tuple[arb, arb, arb]:
        """Gamma**2/2 and two derivatives by T."""
        (_, _, c, s), (_, _, c1, s1), (_, _, c2, s2) = self._orbit(t)
        return (c * c + s * s) / 2, c * c1 + s * s1, c1 * c1 + c * c2 + s1 * s1 + s * s2

    def _gamma(self, t: arb) -> arb:
        """Gamma, by the mean value form."""
        _, _, c, s = self._orbit(t.mid(), 0)[0]
        middle = (c * c + s * s).sqrt()
        if t.is_exact():
            return middle
        (_, _, c, s), (_, _, c1, s1) = self._orbit(t, 1)
        return middle + (c * c1 + s * s1) / (c * c + s * s).sqrt() * (t - t.mid())

    def _jury(self, t: arb) -> tuple[list[arb], list[arb]]:
        """1 - tr + det, 1 + tr + det and 1 - det of the tangent map, and their derivatives by T."""
        fly, stick = self._flows(t)
        inner = [self._land_varied * (motion * self._spring.transpose()) for motion in fly]
        m = self._spring_stuck * (stick[0] * inner[0])
        d = self._spring_stuck * (stick[1] * inner[0] + stick[0] * inner[1])
        det = m.det()
        det1 = d[0, 0] * m[1, 1] + m[0, 0] * d[1, 1] - d[0, 1] * m[1, 0] - m[0, 1] * d[1, 0]
        trace, trace1 = m.trace(), d.trace()
        return [1 - trace + det, 1 + trace + det, 1 - det], [det1 - trace1, det1 + trace1, -det1]

    def _check_admissible(self, t: arb) -> None:
        """Prove gap > 0 in flight and n > 0 in contact of every cycle with a flight time in the ball."""
        if not (t > 0 and t < self.whole):
            raise NotProvenError("the flight time may leave the plate's periods")
        takeoff, landing = self._ends(t)
        check_positive(self._fly, [Condition(self._gap, 3, True)], takeoff, t)
        check_positive(self._stick, [Condition(self._force, 0, True)], landing, self.whole - t)

    def _ends(self, t: arb) -> tuple[arb_mat, arb_mat]:
        """The states at take-off (in flight) and after landing (in contact), by the mean value form."""
        middle = t.mid()
        u, (wide, slope) = self._orbit(middle, 0)[0], self._orbit(t, 1)
        fly = self._flows(t)[0][0]
        start, moved = (self._unknowns * column(x) + self._constant for x in (u, wide))
        along = self._unknowns * column(slope)
        land = self._land * (flow(self._fly, middle) * start)
        by_t = self._land * (self._fly * (fly * moved) + fly * along)
        return start + along * (t - middle), land + by_t * (t - middle)


def _simple_zero(function: Callable[[arb], tuple[arb, arb]], start: float) -> arb:
    """A small ball with exactly one zero, beside a start. function(T) -> (f, f')."""
    x = arb(start)
    for _ in range(_STEPS):
        f, f1 = function(x)
        step = f.mid() / f1.mid()
        x = (x - step).mid()
        if abs(step) < arb(2) ** (-ctx.prec // 2) + f.rad() / f1.mid().abs_lower():
            break
    else:
        raise NotProvenError("Newton's method did not converge")
    if not abs(x - arb(start)) < _NEAR:
        raise NotProvenError("Newton's method left the start")
    f, f1 = function(x)
    ball = around(x, (2 * f / f1).abs_upper() + arb(2) ** (-ctx.prec // 3))
    if not (opposite(function(ball.lower())[0], function(ball.upper())[0]) and function(ball)[1] != 0):
        raise NotProvenError("no simple zero")
    return ball
