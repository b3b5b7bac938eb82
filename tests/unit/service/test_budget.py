"""A budget is kept, and used: levels computed by a runner whose speed is not what its estimates say."""

import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from studies import spec_of

from kernel.params import KERNEL_VERSION
from service import local
from service.budget import Answer, within
from service.views import selection
from service.views.difference import changed
from service.views.registry import stored
from service.views.selection import Stored
from worker.spec.errors import SpecInvalid
from worker.sweep import SweepSpec
from worker.sweep.levels import WHOLE, cells, level

SPEC = SweepSpec(
    gamma={"start": 0.5, "stop": 6, "num": 400}, omega={"start": 0.3, "stop": 1.5, "num": 150}, xi=0.1
)

RIGID = {"kind": "rigid"}
BASIN = {"gamma": 2.0, "omega": 0.5, "xi": 0.1, "settle": 9, "observe": 9, "protocol": {"kind": "basin"}}


class Simulated:
    """A runner on a clock of its own: `cell` seconds a cell and `start` a job, half or twice as a rule."""

    def __init__(self, cell: float, start: float, guess: float) -> None:
        self.now, self.cell, self.start, self.guess = 0.0, cell, start, guess
        self.wait = 0.0  # seconds before the first job, of other work
        self.done: list[SweepSpec] = []

    def clock(self) -> float:
        return self.now

    def seconds(self, spec: SweepSpec) -> float:
        return self.guess * cells(spec, WHOLE) * self.cell

    def is_done(self, spec: SweepSpec) -> bool:
        return spec in self.done

    def took(self, spec: SweepSpec) -> float:
        return cells(spec, WHOLE) * self.cell

    def compute(self, spec: SweepSpec, seconds: float) -> bool:
        if spec in self.done:
            return True
        takes = self.wait + self.start + cells(spec, WHOLE) * self.cell
        self.wait = 0.0
        self.now += min(takes, seconds)
        return takes <= seconds

    def changed(self) -> float:
        return 0.125

    def audit(self, seconds: float) -> str | None:
        self.now += 0.8 * seconds
        return "audited"


@settings(max_examples=40)
@given(st.floats(1e-5, 1e-2), st.floats(0.0, 0.5), st.floats(0.3, 3.0), st.floats(20.0, 900.0))
def test_a_budget_is_never_missed(cell, start, guess, budget):
    runner = Simulated(cell, start, guess)
    answer: Answer = within(SPEC, budget, runner, clock=runner.clock, began=-4.0)
    assert runner.now + 4.0 <= budget - 1.0 + 1e-9  # the end of a process takes a part of what its start took
    grids = [level.cells for level in answer.levels]
    assert grids == sorted(set(grids))


def test_a_budget_is_used():
    rng, used = np.random.default_rng(1), []
    for _ in range(80):
        cell, guess, budget = np.exp(rng.uniform(*np.log([[1e-4, 0.3, 20.0], [1e-2, 3.0, 900.0]])))
        began = rng.choice([0.0, 4.0])
        runner = Simulated(cell, rng.uniform(0.0, 0.5), guess)
        answer = within(SPEC, budget, runner, clock=runner.clock, began=-began)
        assert answer.audit == "audited"
        levels = answer.levels
        whole = levels[-1].steps == WHOLE
        used.append(1.0 if whole else (began + sum(level.seconds for level in levels)) / budget)
    assert np.mean(np.array(used) > 0.6) > 0.95
    assert min(used) > 0.5


def test_a_level_says_how_much_of_the_picture_the_last_one_changed():
    runner, said = Simulated(cell=1e-3, start=0.1, guess=1.0), list[str]()
    levels = within(SPEC, 60.0, runner, lambda text, _: said.append(text), runner.clock).levels
    changes = [" changed 12.5 % of the picture" in text for text in said]
    assert changes == [False, False] + (len(levels) - 1) * [True] + [False]


def test_the_picture_that_a_level_changed_is_counted_over_all_its_cells(tmp_path: Path, monkeypatch):
    """Planes are read together: one by one, many take longer to compare than to compute."""
    fine = SweepSpec(**spec_of((0.4, 2.0, 24), [0.5, 0.55, 0.6, 0.65], [0.05, 0.1], ramp="both"))
    studies, results = list[Stored[SweepSpec]](), []
    for spec in (fine, level(fine, (1, 3, 5))):
        with local.computed(spec, tmp_path / spec.job_id(KERNEL_VERSION), progress=False) as done:
            studies.append(stored(done.record, done.job))
        results.append(local.run(spec, progress=False))
    own, other = results
    near = other.sel({axis: own[axis] for axis in ("xi", "omega", "gamma")}, method="nearest")
    names = ("outcome", "bounces", "periods")
    differs = np.logical_or.reduce([own[name].values != near[name].values for name in names])
    assert 0.0 < differs.mean() < 1.0
    read, reads = selection.read_direction, []
    monkeypatch.setattr(selection, "read_direction", lambda *asked: reads.append(asked) or read(*asked))
    for most, blocks in ((selection.MAX_READ, 1), (4 * 24, 2)):
        monkeypatch.setattr(selection, "MAX_READ", most)
        assert changed(*studies) == pytest.approx(differs.mean(), abs=1e-12)
        assert len(reads) == 2 * 2 * blocks  # of both sweeps in both directions
        reads.clear()


def test_a_budget_whose_first_level_waited_for_other_work_is_used():
    runner = Simulated(cell=1e-3, start=0.1, guess=1.0)
    runner.wait = 10.0
    assert within(SPEC, 30.0, runner, clock=runner.clock).levels[-1].cells > 5_000


def test_a_budget_begins_with_what_is_done():
    runner = Simulated(cell=1e-3, start=0.1, guess=1.0)
    first = within(SPEC, 20.0, runner, clock=runner.clock)
    runner.done = [level(SPEC, first.levels[-1].steps)]
    again = within(SPEC, 20.0, runner, clock=runner.clock, known=first.levels[-1].steps)
    assert again.levels[0].steps == first.levels[-1].steps
    runner.done.append(SPEC)
    assert [each.steps for each in within(SPEC, 1.0, runner, clock=runner.clock).levels] == [WHOLE]


@pytest.mark.parametrize("guess", [0.3, 1.0, 3.0])
def test_a_longer_budget_that_begins_with_what_is_done_is_used(guess):
    """The done level tells the speed: the table may be too wrong to begin a finer one."""
    first = within(SPEC, 20.0, runner := Simulated(1e-3, 0.1, guess), clock=runner.clock).levels[-1]
    runner = Simulated(1e-3, 0.1, guess)
    runner.done = [level(SPEC, first.steps)]
    assert within(SPEC, 60.0, runner, clock=runner.clock, known=first.steps).levels[-1].cells > 25_000


def test_a_budget_too_short_for_any_level_says_what_may_work():
    runner = Simulated(cell=1.0, start=0.0, guess=0.01)
    with pytest.raises(
        SpecInvalid, match=r"was over before the first level of 48 cells was complete; 2s may work"
    ):
        within(SPEC, 1.0, runner, clock=runner.clock)
    with pytest.raises(SpecInvalid, match="; 6s may work"):
        within(SPEC, 2.0, runner, clock=runner.clock, began=runner.clock() - 3.0)
    runner.guess = 1.0
    with pytest.raises(SpecInvalid, match="; 96s may work"):
        within(SPEC, 2.0, runner, clock=runner.clock)


def test_a_budget_over_before_its_kernel_is_compiled_says_more_than_itself(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(local, "is_compiled", lambda spec: False)
    over = {"budget": 70.0, "began": time.monotonic() - 70.0, "progress": False}
    with (
        pytest.raises(SpecInvalid, match=r"was compiled; 1[4-9]\ds may work"),
        local.computed(SPEC, tmp_path, **over),
    ):
        pass


def test_a_budget_is_refused_before_anything_is_computed(tmp_path: Path):
    for spec, budget, rule in (
        (SPEC, 0.0, "must be seconds above 0, not 0"),
        (BASIN, 5.0, "is for sweeps; this study"),
    ):
        with pytest.raises(SpecInvalid, match=f"budget: {rule}"):
            local.run(spec, tmp_path / "a.zarr", budget=budget, progress=False)
    assert not list(tmp_path.iterdir())


def test_a_run_within_a_budget_is_the_sweep_with_its_audit():
    spec = spec_of((0.8, 3, 60), 0.5, 0.26)
    found = local.run(spec, budget=120.0, progress=False)
    assert found.sizes["gamma"] == 60
    assert "have another outcome or mode" in found.attrs["audit"]
    assert found.flight_time.equals(local.run(spec, progress=False).flight_time)


def test_a_budget_leaves_what_another_study_has_computed_and_takes_up_its_own_levels(tmp_path: Path):
    store = tmp_path / "sweep.zarr"
    spec = {"gamma": {"start": 0.8, "stop": 3, "num": 60}, "omega": 0.5, "xi": 0.26} | {"model": RIGID}
    with local.computed(spec | {"xi": 0.1}, local.partial_of(store), progress=False):
        pass  # as an interrupted run leaves it
    with pytest.raises(FileExistsError, match="another specification"):
        local.run(spec, store, budget=60.0, progress=False)
    assert local.partial_of(store).exists()
    other = tmp_path / "other.zarr"
    with local.computed(level(SweepSpec(**spec), (1, 1, 4)), local.partial_of(other), progress=False):
        pass
    assert local.run(spec, other, budget=60.0, progress=False).sizes["gamma"] == 60


def test_the_same_run_within_a_budget_goes_on_from_the_finest_level_done(tmp_path: Path):
    store, begun, done = tmp_path / "sweep.zarr", [], level(SPEC, (1, 24, Fraction(96, 7)))
    with local.computed(done, local.partial_of(store), progress=False):
        pass  # as an interrupted run leaves it
    local.run(SPEC, store, budget=4.0, progress=lambda job: begun.append(job.id))
    assert begun[0] == done.job_id(KERNEL_VERSION)
