"""Ball, time steps and lanes over the whole range of parameters, each beside its slow twin.

As `test_extremes` does for the rigid and the soft plate: an outcome in time, every phase where the
equations lead, energy closed, nothing below the plate, no event missed. Of time steps the energy is
closed to the scheme's order only (test_stepped has that); everything else holds for them too.
"""

import math
import time

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kernel_runs import TWO_PI, Model, compile_models, examples, phases, powers, recorded, run
from naive import Setting
from naive_ball import Fall
from naive_steps import Stepper

from kernel import interface
from kernel.cell import KEPT_FLIGHTS
from kernel.interface import plate_phase
from kernel.models.ball import BallPlate
from kernel.numerics.first_root import HORIZON, ROOT
from kernel.params import Outcome
from kernel.step_limits import stable_steps_per_contact, steps_per_period

ENDED = (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.AT_REST, Outcome.SETTLING)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile before the first test: these tests bound the time of a run."""
    compile_models()


GAMMA = st.one_of(st.sampled_from([1.0, 1.0 + 1e-12, 2.0, math.hypot(1.0, math.pi)]), powers(-3.0, 2.0))
EPSILON = st.one_of(st.sampled_from([0.0, 0.15, 0.5]), st.floats(0.0, 0.99))


@given(gamma=GAMMA, epsilon=EPSILON)
@examples(300)
def test_any_ball_ends_with_an_outcome_in_time(gamma, epsilon):
    began = time.process_time()
    line = run(gamma, 1.0, 1.0, Model.BALL, restitution=epsilon, settle=1, observe=3)
    assert time.process_time() - began < 2.0
    assert line.outcome[0] in ENDED
    assert (line.outcome[0] == Outcome.AT_REST) == (gamma <= 1.0) or gamma > 10.0 or gamma < 1.0 + 1e-9
    assert np.all(np.isfinite(line.end_state[0]))
    assert np.sum(recorded(line)) <= 3.0 * TWO_PI * (1.0 + 1e-12)


@given(gamma=GAMMA.filter(lambda gamma: gamma > 0.5), epsilon=EPSILON)
@examples(100)
def test_any_phase_of_a_ball_obeys_the_equations_of_motion(gamma, epsilon):
    ball = interface.prepare(BallPlate(np.array([epsilon])), 0, gamma, 1.0, 1.0)
    phi, state = 0.0, interface.rest(ball)
    flying = interface.flies(ball, plate_phase(phi), state)
    for _ in range(12):
        follow = interface.flight if flying else interface.contact
        phase = follow(ball, plate_phase(phi), state, 20.0 * TWO_PI, 100_000)
        assert phase.ending in (ROOT, HORIZON)
        assert 0.0 <= phase.tau < math.inf
        if flying:
            check_flight(Fall(gamma, phi, state[0], state[1]), phase, epsilon)
        else:
            check_contact(gamma, phi, phase)
        if phase.ending == HORIZON:
            return
        phi = math.fmod(phi + phase.tau, TWO_PI)
        state, flying = phase.state, phase.in_flight


def check_flight(fall: Fall, phase, epsilon: float) -> None:
    """Its end is the equations', its energy closed, and no landing was missed on the way."""
    tau, size = phase.tau, 1.0 + abs(fall.gap1) + phase.tau * (1.0 + 1.0 / fall.gamma)
    gap, gap1 = fall.exactly(tau)
    if phase.ending == ROOT:
        assert abs(gap) <= 1e-13 * size * (1.0 + tau)
        assert phase.state.gap == 0.0
        assert phase.state.gap1 == pytest.approx(max(-epsilon * gap1, 0.0), abs=1e-12 * size)
    else:
        assert phase.state.gap == pytest.approx(max(gap, 0.0), abs=1e-12 * size * (1.0 + tau))
        assert phase.state.gap1 == pytest.approx(gap1, abs=1e-12 * size)
    before, after = energy(fall, fall.phi, fall.gap, fall.gap1), energy(fall, fall.phi + tau, gap, gap1)
    assert after == pytest.approx(before, abs=1e-12 * size * size)
    if tau > 0.0:
        taus = np.unique(np.concatenate([np.linspace(0.0, tau, 4000), tau * np.geomspace(1e-9, 1.0, 400)]))
        assert fall.gaps(taus).min() >= -1e-13 * size * (1.0 + tau)


def energy(fall: Fall, phi: float, gap: float, gap1: float) -> float:
    """Kinetic and potential, in the laboratory."""
    return 0.5 * (gap1 - math.sin(phi)) ** 2 + (gap + math.cos(phi)) / fall.gamma


def check_contact(gamma: float, phi: float, phase) -> None:
    """The plate presses all the while, and no more at the end."""
    assert (phase.state.gap, phase.state.gap1) == (0.0, 0.0) or phase.ending == HORIZON
    press = 1.0 / gamma - np.cos(phi + np.linspace(0.0, phase.tau, 4000))
    assert press.min() >= -1e-12
    if phase.ending == ROOT and phase.in_flight:
        assert press[-1] == pytest.approx(0.0, abs=1e-12)


@st.composite
def stepped(draw: st.DrawFn, smallest: float) -> tuple[Setting, int, str, str]:
    """A cell with a contact of at least that depth, and steps that a specification would accept."""
    events = draw(st.sampled_from(["located", "plain"]))
    name = draw(st.sampled_from(["verlet", "euler"]))
    s = Setting(
        gamma=draw(st.one_of(st.just(2.0), powers(-3.0, 2.0))),
        omega=draw(st.one_of(st.sampled_from([1.0, math.sqrt(2.0)]), powers(-1.5, 3.0))),
        xi=draw(st.one_of(st.sampled_from([0.0, math.sqrt(0.5), 1.0]), powers(-3.0, 1.5))),
        soft=True,
        restitution=draw(st.one_of(st.just(1.0), powers(-3.0, 0.0))),
        penetration=draw(powers(smallest, -0.5)),
        adhesive=draw(st.booleans()),
    )
    fewest = stable_steps_per_contact(
        s.omega, s.xi, s.restitution, s.penetration, adhesive=s.adhesive, scheme=name
    )
    number = max(20, int(fewest))
    steps = steps_per_period(s.restitution, s.penetration, number, adhesive=s.adhesive)
    assume(int(steps) * s.penetration < 1e4)  # seldom: a spring far stiffer than its contact
    return s, number, name, events


def run_stepped(s: Setting, number: int, name: str, events: str, **window):
    return run(
        s.gamma, s.omega, s.xi, Model.STEPPED, restitution=s.restitution, penetration=s.penetration,
        adhesive=s.adhesive, steps_per_contact=number, scheme=name, events=events, **window,
    )  # fmt: skip


@given(case=stepped(-4.0))
@examples(80)
def test_any_stepped_cell_ends_with_an_outcome(case):
    """Finite, its flights counted, and above the plate where it is in flight."""
    line = run_stepped(*case, settle=1, observe=2)
    # of more flights than are kept no mode can be told
    assert line.outcome[0] in ENDED or (
        line.outcome[0] == Outcome.UNRESOLVED and line.flights[0] > KEPT_FLIGHTS
    )
    end = line.end_state[0]
    assert np.all(np.isfinite(end))
    assert end[2] >= 0.0 if end[1] == 1.0 and case[0].adhesive else end[2] <= 0.0 or end[1] == 1.0
    times, takeoffs = recorded(line), line.takeoff_phase[0, : len(recorded(line))]
    assert np.all(times > 0.0)
    assert np.sum(times) <= 2.0 * TWO_PI * (1.0 + 1e-12)
    assert np.all((takeoffs >= 0.0) & (takeoffs < TWO_PI))


@given(case=stepped(-2.0))
@examples(40)
def test_time_steps_are_those_of_their_twin(case):
    s, number, name, events = case
    steps = int(steps_per_period(s.restitution, s.penetration, number, adhesive=s.adhesive))
    assume(steps < 4000)
    mine = recorded(run_stepped(*case, settle=0, observe=1, keep=4096))
    stepper = Stepper(s, steps, 0.5 if name == "verlet" else 0.0)
    twin = stepper.plain_flights(1) if events == "plain" else stepper.flights(1)
    shortest = 1e-6
    twin = np.array([flown.time for flown in twin])
    mine, twin = mine[mine > shortest], twin[twin > shortest]
    assert len(mine) == len(twin)
    np.testing.assert_allclose(mine, twin, rtol=1e-6, atol=1e-8)


# --- cost -----------------------------------------------------------------------------------


@pytest.mark.parametrize("soft", [False, True])
def test_no_cell_of_the_default_range_costs_a_hundred_times_the_median(soft):
    """Gamma and xi up to 10, Omega from 0.1 to 10; in evaluations, which no other program disturbs.

    The median of those that bounce: what rests costs next to nothing.
    """
    rng = np.random.default_rng(2)
    used, bouncing = [], []
    for _ in range(120):
        gamma, omega, xi = (10.0 ** rng.uniform(low, 1) for low in (-1, -1, -3))
        s = Setting(gamma, omega, xi, soft, 0.01 if soft else 0.0)
        steps = list(phases(s, 20, 100_000))
        used.append(sum(step.used for step in steps))
        bouncing.append(len(steps) > 20)
    assert sum(bouncing) > 20
    assert max(used) <= 100 * np.median(np.array(used)[bouncing])
