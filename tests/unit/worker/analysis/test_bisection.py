"""Thresholds finer than the grid: Eq. 25 upwards, simulated ramps downwards."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chunks import compute

import worker.analysis.bisection
from kernel.cycles.thresholds import thresholds as fold_at
from kernel.params import Cell, Outcome
from kernel.threshold import threshold
from worker import store
from worker.analysis.bisection import Refined, Status, by_bisection
from worker.analysis.prediction import predict, predict_each, search_each
from worker.spec.contact_models import Rigid
from worker.sweep import SweepSpec

TOLERANCE = 1e-4

#: Through resonance, and through the antiresonance at sqrt(2) where a spring hardly loads the plate.
OMEGA = [*np.geomspace(0.3, 1.35, 10).tolist(), 1.4, 1.4142, 1.45, *np.geomspace(1.6, 4.0, 7).tolist()]

#: Simulated at xi = 0.05, ramped down by 0.004 with 120 periods a step, last bouncing gamma.
DESCENDING = {0.56: 0.743, 0.60: 0.554, 0.62: 0.508, 0.66: 0.600, 0.70: 0.671}


def computed(folder: Path, **fields: Any) -> tuple[SweepSpec, str]:
    """A sweep and its finished store."""
    spec = SweepSpec(**{"model": {"kind": "rigid"}, "keep": 1, "observe": 20} | fields)
    url = str(folder / "sweep.zarr")
    compute(url, spec)
    return spec, url


def ramp(direction: str) -> dict[str, str]:
    return {"kind": "ramp", "axis": "gamma", "direction": direction}


def thresholds(spec: SweepSpec, url: str, tolerance: float) -> Refined:
    return by_bisection(spec, url, 0, tuple(range(len(spec.axis_values("omega")))), tolerance)


@pytest.mark.parametrize("xi", [0.01, 0.2, 1.0])
@pytest.mark.parametrize(
    "model", [{"kind": "rigid"}, {"kind": "soft", "restitution": 0.01}], ids=["rigid", "soft"]
)
def test_the_ascending_threshold_is_eq_25(tmp_path: Path, xi: float, model: dict[str, Any]):
    """On a grid of steps of 7%, whose own onsets are off by as much, and by half at the antiresonance."""
    gamma = {"start": 0.01, "stop": 80.0, "num": 130, "spacing": "log"}
    spec, url = computed(tmp_path, gamma=gamma, omega=OMEGA, xi=xi, protocol=ramp("up"), model=model)
    refined = thresholds(spec, url, TOLERANCE)
    found = np.array(refined.up)
    assert refined.up_status == (Status.FOUND,) * 20
    np.testing.assert_allclose(found, threshold(np.array(OMEGA), xi), rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize(
    "model",
    [{"kind": "rigid"}, {"kind": "soft", "restitution": 0.1}],
    ids=lambda model: f"{model['kind']} {model.get('restitution', 0)}",
)
def test_the_descending_threshold_is_that_of_the_model_page(tmp_path: Path, model: dict[str, Any]):
    """From a bouncing state at the top: within a step of 0.004, on the grid and refined.

    The last cells that are not at rest may still settle: the refinement decides whether they bounce.
    """
    gamma = {"start": 0.4, "stop": 1.2, "num": 201}
    fields = {"gamma": gamma, "omega": list(DESCENDING), "xi": 0.05, "protocol": ramp("both")}
    spec, url = computed(tmp_path, **fields, model=model, settle=100)
    outcome = store.read_slice(url, ("outcome",), direction=1, xi=0)["outcome"]
    on_the_grid = spec.axis_values("gamma")[np.argmax(outcome != Outcome.AT_REST, axis=1)]
    np.testing.assert_allclose(on_the_grid, list(DESCENDING.values()), rtol=0, atol=0.0041)
    found = thresholds(spec, url, TOLERANCE)
    assert found.down_status == (Status.FOUND,) * len(DESCENDING)
    np.testing.assert_allclose(found.down, on_the_grid, rtol=0, atol=0.0041)
    np.testing.assert_allclose(found.up, threshold(np.array(spec.omega), 0.05), rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("window", [{}, {"settle": 100}], ids=["auto", "120 periods"])
def test_bouncing_ends_at_the_fold_of_its_cycle(tmp_path: Path, window: dict[str, int]):
    """Not at the ghost below it, which outlives any window."""
    folds = {omega: fold_at(omega, 0.05).down for omega in (0.56, 0.58, 0.60, 0.61, 0.62, 0.64, 0.66, 0.70)}
    gamma = {"start": 0.4, "stop": 1.2, "num": 81}
    spec, url = computed(tmp_path, gamma=gamma, omega=list(folds), xi=0.05, protocol=ramp("both"), **window)
    found = thresholds(spec, url, 1e-5)
    assert found.down_status == (Status.FOUND,) * len(folds)
    np.testing.assert_allclose(found.down, list(folds.values()), rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("restitution", "observe", "end"), [(0.0, 20, 0.591655), (0.5, 1_000, 0.6360205)], ids=["0", "0.5"]
)
def test_bouncing_ends_where_its_cycle_spirals_out(
    tmp_path: Path, restitution: float, observe: int, end: float
):
    """At unit multipliers, by an integrator of their own; just below, leaving takes 20,000 periods."""
    gamma, model = {"start": 0.51, "stop": 1.21, "num": 29}, {"kind": "rigid", "restitution": restitution}
    fields = {"gamma": gamma, "omega": [0.58], "xi": 0.03, "protocol": ramp("both"), "model": model}
    spec, url = computed(tmp_path, **fields, observe=observe)
    found = thresholds(spec, url, 1e-5)
    assert found.down_status == (Status.FOUND,)
    assert found.down == pytest.approx((end,), abs=1e-5)


def test_chaos_that_outlives_the_patience_is_no_threshold(tmp_path: Path):
    """Half of it lives for 6,000 periods, and some at a single gamma."""
    model = {"kind": "rigid", "restitution": 0.9}
    gamma = {"start": 0.1, "stop": 4.0, "num": 53}
    spec, url = computed(tmp_path, gamma=gamma, omega=[0.917, 1.8696], xi=0.005, model=model)
    onset = threshold(np.array(spec.omega), 0.005)
    np.testing.assert_allclose(thresholds(spec, url, TOLERANCE).up, onset, rtol=0, atol=TOLERANCE)


def test_a_chaotic_cell_that_seems_to_settle_does_not_lose_its_line(tmp_path: Path):
    model = {"kind": "soft", "restitution": 0.793, "penetration": 0.1, "adhesive": False}
    gamma = {"start": 0.1, "stop": 4.0, "num": 53}
    spec, url = computed(tmp_path, gamma=gamma, omega=[0.9601], xi=0.02, model=model, observe=30)
    found = thresholds(spec, url, TOLERANCE)
    assert found.up_status == (Status.FOUND,)
    assert found.up == pytest.approx((0.143009,), abs=TOLERANCE)


@pytest.mark.parametrize("protocol", [{"kind": "rest"}, ramp("both")], ids=["rest", "ramp"])
def test_cells_that_stay_undecided_are_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: dict[str, str]
):
    """The threshold is then the lowest Gamma that is known to bounce."""

    def run(spec: SweepSpec, cell: Cell, *_: Any) -> tuple[Outcome, Any]:
        low, high = np.array([0.7, 0.7005]) < cell.gamma
        return (Outcome.APERIODIC if high else Outcome.SETTLING if low else Outcome.AT_REST), np.zeros(6)

    spec, url = computed(tmp_path, gamma=[0.4, 0.9, 1.2], omega=[0.6], xi=0.05, protocol=protocol)
    monkeypatch.setattr(worker.analysis.bisection, "_run", run)
    for tolerance in (1e-2, 1e-4, 1e-6):
        found = thresholds(spec, url, tolerance)
        known = [gamma for gamma in found.up + found.down if np.isfinite(gamma)]
        assert known == pytest.approx([0.7005] * len(spec.directions), abs=max(tolerance, 5e-4))


def test_hops_that_outlive_the_window_are_no_threshold(tmp_path: Path):
    """The lowest cells of the grid that bounce in so short a window come to rest."""
    gamma, window = {"start": 0.1, "stop": 1.5, "num": 141}, {"settle": 20, "observe": 20}
    spec, url = computed(tmp_path, gamma=gamma, omega=[0.9, 1.1], xi=0.005, **window)
    onset = threshold(np.array(spec.omega), 0.005)
    outcome = store.read_slice(url, ("outcome",), direction=0, xi=0)["outcome"]
    lowest = spec.axis_values("gamma")[np.argmax(outcome != Outcome.AT_REST, axis=1)]
    assert (lowest < 0.99 * onset).all()
    np.testing.assert_allclose(thresholds(spec, url, 1e-5).up, onset, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("gamma", "protocol", "up", "down"), [
    ([2.0, 3.0], ramp("both"), Status.BELOW, Status.BELOW),
    ([0.1, 0.2], ramp("both"), Status.ABOVE, Status.NEVER),
    ([2.0, 3.0], ramp("down"), Status.NOT_RAMPED, Status.BELOW),
    ([2.0], {"kind": "rest"}, Status.BELOW, Status.NOT_RAMPED),
])  # fmt: skip
def test_a_change_that_the_sweep_does_not_hold_is_not_made_up(
    tmp_path: Path, gamma: list[float], protocol: dict[str, str], up: Status, down: Status
):
    spec, url = computed(tmp_path, gamma=gamma, omega=[0.5], xi=0.26, protocol=protocol)
    found = thresholds(spec, url, 1e-3)
    assert np.isnan(found.up + found.down).all()
    assert (found.up_status, found.down_status) == ((up,), (down,))


@pytest.mark.parametrize(
    ("limit", "most", "up"), [("MAX_CELLS", 3, Status.NOT_REFINED), ("PATIENCE", 1, Status.FOUND)]
)
def test_a_refinement_that_reaches_its_limit_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, most: int, up: Status
):
    fields = {"gamma": [0.4, 0.9, 1.2], "omega": [0.6], "xi": 0.05, "settle": 20, "observe": 10}
    spec, url = computed(tmp_path, protocol=ramp("both"), **fields)
    within = thresholds(spec, url, TOLERANCE)
    assert (*within.up_status, *within.down_status) == (Status.FOUND, Status.FOUND)
    monkeypatch.setattr(worker.analysis.bisection, limit, most)
    found = thresholds(spec, url, TOLERANCE)
    assert (found.up_status, found.down_status) == ((up,), (Status.NOT_REFINED,))
    assert np.isfinite(found.up + found.down).tolist() == [up is Status.FOUND, False]


def test_what_has_no_closed_form_is_unresolved_and_says_why():
    resonant, slow = predict(1.0, 0.0), predict(0.001, 0.05)
    (searched,) = search_each(Rigid(restitution=0.3), (1.0,), 0.0)
    for found, omega, xi in ((resonant, 1.0, 0.0), (searched, 1.0, 0.0), (slow, 0.001, 0.05)):
        assert (found.omega, found.xi, found.cause) == (omega, xi, "unresolved")
        assert found.gamma_th == pytest.approx(float(threshold(omega, xi)))
        assert np.isnan([found.jump, found.down]).all()
        assert found.fold is None
    assert "omega: must be at least about 0.038" in slow.reason
    assert resonant.reason == searched.reason
    assert "xi: must be > 0 at omega = 1" in searched.reason
    one, two = predict_each((0.6, 0.62), 0.05)
    assert (one.down, two.down) == (predict(0.6, 0.05).down, predict(0.62, 0.05).down)
    assert one.cause == "fold (1,1)"
