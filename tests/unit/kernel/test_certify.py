"""A periodic cell ends once its cycle is certified: which cells, and what is recorded of them."""

import json
from typing import Any

import numpy as np
import pytest
from kernel_runs import assert_same_bytes, part
from paths import GOLDEN
from tables import for_each

from kernel.line import LineRun, run_line
from kernel.models.ball import BallPlate
from kernel.models.rigid import RigidPlate
from kernel.models.soft import SoftPlate
from kernel.models.stepped import SteppedPlate
from kernel.params import Cell, KernelInputError, Line, Outcome, Start

N = 40
RANDOM = np.random.default_rng(5)
GAMMA = np.concatenate([[0.4], RANDOM.uniform(0.5, 6.0, N - 1)])
OMEGA, XI = np.exp(RANDOM.uniform(np.log(0.2), np.log(2.0), N)), np.exp(RANDOM.uniform(np.log(0.02), 0.0, N))

ZERO = np.zeros(N)
PLATES: dict[str, Any] = {
    "rigid": RigidPlate(ZERO),
    "rigid, restitution": RigidPlate(ZERO + 0.3),
    "soft, adhesive": SoftPlate(ZERO + 0.01, ZERO + 1e-3, True),
    "soft, nonadhesive": SoftPlate(ZERO + 0.01, ZERO + 1e-3, False),
    "ball": BallPlate(ZERO),
    "ball, restitution": BallPlate(ZERO + 0.3),
}
WINDOW: dict[str, Any] = {"settle": 200, "observe": 100, "keep": 24, "micro_flight": 0.05}
CERTIFY: dict[str, Any] = {"certify": True, "settle_until": 3000, **WINDOW}

#: Plate periods.
LATER = 5040

#: The ramp down at Omega 0.6, xi 0.05: where the mode (1, 1) ends, by continuation of its cycle.
FOLD = 0.553244593


def plate_at(plate: str, cells: Any) -> Any:
    fields = PLATES[plate]
    return type(fields)(*(x[cells] if isinstance(x, np.ndarray) else x for x in fields))


def line_of(plate: str, **options: Any) -> Line:
    fields: dict[str, Any] = {"carry": False, **CERTIFY, **options}
    return run_line(GAMMA, OMEGA, XI, plate=PLATES[plate], **fields)


@for_each("plate", [name for name in PLATES if "ball" not in name])
def test_a_motion_that_still_grows_on_the_plate_is_not_at_rest(plate: str):
    """Near resonance at low damping: 13 % and 3 % above Eq. 25, and below it."""
    cells: Any = ([0.0045, 0.00041, 0.0039], np.ones(3), [1e-3, 1e-4, 1e-3])
    few = plate_at(plate, slice(3))
    line = run_line(*map(np.array, cells), plate=few, carry=False, **CERTIFY)
    assert line.outcome.tolist() == [Outcome.PERIODIC, Outcome.SETTLING, Outcome.AT_REST]
    fixed = run_line(*map(np.array, cells), plate=few, carry=False, **WINDOW)
    assert fixed.outcome.tolist() == [Outcome.SETTLING, Outcome.SETTLING, Outcome.AT_REST]


@for_each("plate", [name for name in PLATES if "ball" not in name])
def test_hops_that_die_out_below_eq_25_end_at_rest(plate: str):
    """At low damping they outlive the window: 5 %, 0.4 % and 1.2 % below."""
    cells: Any = ([5.585, 3.495, 0.6047], [1.5867, 1.2794, 1.111], [7.86e-4, 1.417e-3, 8.09e-4])
    few = plate_at(plate, slice(3))
    line = run_line(*map(np.array, cells), plate=few, carry=False, **{**CERTIFY, "settle_until": 5000})
    assert line.outcome.tolist() == [Outcome.AT_REST] * 3


def test_hops_that_die_out_settle_in_a_fixed_window_too():
    """By the window and what is followed beyond it, where the window alone does not tell."""
    contact = SoftPlate(np.array([0.41]), np.array([0.038]), adhesive=True)
    fixed: dict[str, Any] = {**WINDOW, "observe": 300, "plate": contact, "carry": False}
    line = run_line(np.array([6.2662]), np.array([1.571]), np.array([0.00202]), **fixed)
    assert line.outcome.tolist() == [Outcome.SETTLING]
    ball = {**WINDOW, "settle": 50, "observe": 20, "plate": BallPlate(np.array([0.6426804207941106]))}
    line = run_line(np.array([2.9095337171937534]), np.ones(1), np.ones(1), carry=False, **ball)
    assert line.outcome.tolist() == [Outcome.APERIODIC]  # a ball never rests there


@for_each("plate", PLATES)
def test_certified_cells_are_on_the_cycle_that_a_long_run_approaches(plate: str):
    """LATER is a multiple of most cycles' periods, so that both windows end at the same flight."""
    line = line_of(plate)
    long = line_of(plate, certify=False, settle=200 + LATER, settle_until=None, in_lanes=False)
    certified = line.outcome == Outcome.PERIODIC
    assert np.count_nonzero(certified) > N / 4
    seen = certified & (3 * line.periods <= WINDOW["observe"])  # cycles that the long run's window tells
    transients = (long.outcome == Outcome.PERIODIC) & ~certified
    assert np.count_nonzero(transients) <= 1
    assert np.all(line.outcome[transients] == Outcome.APERIODIC)
    assert np.all(long.outcome[seen] == Outcome.PERIODIC)
    assert np.count_nonzero(line.outcome == Outcome.SETTLING) == 0
    np.testing.assert_array_equal(line.outcome == Outcome.AT_REST, long.outcome == Outcome.AT_REST)
    for name in ("bounces", "periods"):
        np.testing.assert_array_equal(getattr(line, name)[seen], getattr(long, name)[seen], err_msg=name)
    same = seen & (LATER % np.maximum(line.periods, 1) == 0)
    assert np.count_nonzero(same) > 0.8 * np.count_nonzero(certified)
    np.testing.assert_array_equal(line.flights[same], long.flights[same])
    # where what is left of the long run's way there is less
    near = same & (line.multiplier ** (LATER / np.maximum(line.periods, 1)) < line.flight_error)
    assert np.count_nonzero(near) > 0.7 * np.count_nonzero(certified)
    for name in ("flight_time", "takeoff_phase"):
        error = np.abs(getattr(line, name) - getattr(long, name))[near]
        assert np.all((error <= line.flight_error[near, None]) | np.isnan(error)), name


def test_the_error_of_short_flights_is_bounded_where_they_hardly_leave_the_plate():
    cells = np.array(json.loads((GOLDEN / "touches.json").read_text())["cells"])
    gamma, omega, xi, true = cells.T.copy()
    plate = RigidPlate(np.zeros(len(true)))
    line = run_line(gamma, omega, xi, plate=plate, **{"carry": False, **CERTIFY})
    assert np.all(line.outcome == Outcome.PERIODIC)
    error = np.nanmax(np.abs(line.flight_time - true[:, None]), axis=1)
    assert np.all(error <= line.flight_error)


def test_the_error_is_bounded_where_changes_of_state_and_phase_cancel():
    """The true flight by Newton's method with 40 digits (mpmath)."""
    cell = [np.array([x]) for x in (7.334, 0.03605, 0.4974)]
    plate = SoftPlate(np.array([0.0136]), np.array([0.0007841]), True)
    line = run_line(*cell, plate=plate, **{"carry": False, **CERTIFY})
    error = abs(line.flight_time[0, 0] - 15.335594360410346)
    assert 1e-12 < error < line.flight_error[0]


@for_each("plate", PLATES)
def test_certificates_are_of_periodic_cells_only(plate: str):
    line = line_of(plate)
    certified = line.outcome == Outcome.PERIODIC
    for name in ("flight_error", "multiplier", "multiplier_angle"):
        np.testing.assert_array_equal(np.isfinite(getattr(line, name)), certified, err_msg=name)
    assert np.all((line.multiplier[certified] >= 0.0) & (line.multiplier[certified] < 1.0))
    assert np.all((line.multiplier_angle[certified] >= 0.0) & (line.multiplier_angle[certified] <= np.pi))


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("window", [(200, 100), (100, 20), (50, 10)], ids=str)
def test_a_ramp_ends_at_the_last_cell_above_the_fold(step: float, window: tuple[int, int]):
    """Below it flights repeat within 1e-6 for up to thousands of periods beside the cycle that there was."""

    def ramp(gamma: Any, start: Start | None) -> Line:
        same = np.ones(len(gamma))
        fields = CERTIFY | {"settle": window[0], "observe": window[1], "settle_until": 5000}
        return run_line(
            gamma, 0.6 * same, 0.05 * same, plate=RigidPlate(0.0 * same), carry=True, start=start, **fields
        )

    coarse = np.arange(1.2, 0.5545, -1e-3)
    state = ramp(coarse, None).end_state[-1]
    first = np.floor((coarse[-1] - FOLD) / step) * step
    gamma = coarse[-1] - step * np.arange(round(first / step) - 25, round(first / step) + 9)
    gamma = gamma[gamma < coarse[-1]]
    line = ramp(gamma, Start(state, Cell(float(coarse[-1]), 0.6, 0.05)))
    above = gamma > FOLD
    assert above.any()
    np.testing.assert_array_equal(line.outcome == Outcome.PERIODIC, above)
    np.testing.assert_array_equal(line.outcome == Outcome.AT_REST, ~above)
    assert line.outcome[-1] == Outcome.AT_REST


@for_each("plate", PLATES)
@for_each("carry", [False, True])
def test_lanes_and_scalars_certify_the_same_cycles(plate: str, carry: bool):
    lanes, scalar = (line_of(plate, carry=carry, in_lanes=in_lanes) for in_lanes in (True, False))
    both = (lanes.outcome == Outcome.PERIODIC) & (scalar.outcome == Outcome.PERIODIC)
    if not carry:  # a ramp may follow another branch after chaos
        np.testing.assert_array_equal(lanes.outcome, scalar.outcome)
        np.testing.assert_allclose(lanes.flight_time[both], scalar.flight_time[both], atol=1e-9)
        np.testing.assert_allclose(lanes.multiplier[both], scalar.multiplier[both], atol=1e-7)
    assert both.any()


@for_each("plate", ["rigid", "soft, adhesive", "ball"])
def test_a_cell_has_the_same_bytes_alone_and_among_others(plate: str):
    line = line_of(plate)
    for i in range(0, N, 7):
        one = slice(i, i + 1)
        five = [i] * 5
        run = LineRun(GAMMA[five], OMEGA[five], XI[five], plate=plate_at(plate, five), carry=False, **CERTIFY)
        run.advance()
        for k in range(5):
            assert_same_bytes(part(run.line, slice(k, k + 1)), part(line, one))


@for_each("plate", ["rigid", "soft, adhesive", "ball"])
def test_a_ramp_goes_on_from_the_cycle(plate: str):
    line = line_of(plate, carry=True)
    start = None
    for i in range(N):
        one = slice(i, i + 1)
        cell = run_line(
            GAMMA[one], OMEGA[one], XI[one], plate=plate_at(plate, one), carry=True, start=start, **CERTIFY
        )
        assert_same_bytes(cell, part(line, one))
        start = Start(cell.end_state[0], Cell(GAMMA[i], OMEGA[i], XI[i]))


def test_exponents_and_contacts_without_variations_are_refused():
    with pytest.raises(KernelInputError, match="certify: must be false with exponents"):
        line_of("rigid", exponents=2)
    stepped = SteppedPlate(ZERO + 0.69, ZERO + 1e-2, np.full(N, 400), True, 0.5)
    with pytest.raises(KernelInputError, match="certify: must be false"):
        run_line(GAMMA, OMEGA, XI, plate=stepped, carry=False, **CERTIFY)


@pytest.mark.parametrize("observe", [100, 250])
def test_a_cell_that_settles_late_goes_on_until_it_is_certified(observe: int):
    """The cell takes more than 1,000 periods; a window of 250 is longer than any that follows it."""
    cell = np.array([[5.8851], [1.1539], [0.9968]])
    options = {**CERTIFY, "observe": observe, "settle_until": 20_000}
    line = run_line(*cell, plate=RigidPlate(ZERO[:1]), carry=False, **options)
    assert line.outcome[0] == Outcome.PERIODIC
    assert (line.bounces[0], line.periods[0]) == (7, 12)


def test_long_cycles_that_a_rebounding_ball_repeats_by_rounding_are_aperiodic():
    gamma = np.array([2.151104908484363, 2.025316690463456, 2.000166723904982, 5.540599688174893])
    line = run_line(gamma, np.ones(4), np.ones(4), plate=BallPlate(np.full(4, 0.3)), carry=False, **CERTIFY)
    assert line.outcome.tolist() == 4 * [Outcome.APERIODIC]
