"""Cells that each begin from a state of their own, as the starts of a basin do."""

import math

import numpy as np
import pytest
from kernel_runs import Model, assert_same_bytes, run

from kernel.params import KernelInputError, Line, Outcome

CELL = (1.27, 0.5, 0.26)  # two attractors of one bounce


def dropped(states: np.ndarray, **others: object) -> Line:
    n = len(states)
    return run(*(np.full(n, x) for x in CELL), states=states, **{"settle": 400, "observe": 40} | others)


@pytest.mark.parametrize("model", [Model.RIGID, Model.SOFT, Model.BALL])
def test_the_state_of_rest_gives_the_record_from_rest(model: Model):
    gamma = np.array([1.1, 1.27, 1.5, 3.6])
    rest = np.zeros((4, 6))
    rest[:, 4] = -(0.5**2) / gamma
    if model is Model.SOFT:
        rest[:, 2] = -2.0 * 1e-6 / gamma
    options = {"restitution": 0.3, "observe": 30}
    given = run(gamma, 0.5, 0.26, model, states=rest, **options)
    plain = run(gamma, 0.5, 0.26, model, **options)
    for name in ("outcome", "bounces", "periods", "flights"):
        assert getattr(given, name).tolist() == getattr(plain, name).tolist(), name
    np.testing.assert_allclose(given.flight_time, plain.flight_time, atol=1e-9)


def test_lanes_and_one_by_one_agree_and_so_does_every_division_of_the_starts():
    """With exponents cells are computed one by one; the height and the phase decide the attractor."""
    # the spring relaxed and at rest in the laboratory, above the plate
    phases, heights = 2.0 * math.pi * np.arange(6) / 6, (np.arange(6) + 0.5) * 10.0 / 6
    states = np.zeros((6, 6, 6))
    states[..., 0], states[..., 1], states[..., 2] = phases, 1.0, heights[:, None]
    states[..., 3] = np.sin(phases)
    states = states.reshape(-1, 6)
    lanes, single = dropped(states), dropped(states, exponents=1)
    assert set(np.round(lanes.flight_time[:, 0], 6)) == {4.631301, 3.374643}
    assert lanes.outcome.tolist() == single.outcome.tolist() == [Outcome.PERIODIC] * 36
    np.testing.assert_allclose(lanes.flight_time, single.flight_time, atol=1e-9)
    parts = [dropped(states[:7]), dropped(states[7:])]
    assert_same_bytes(lanes, Line(*(np.concatenate(pair) for pair in zip(*parts, strict=True))))


def test_wrong_states_are_refused():
    for states in (np.zeros((2, 6)), np.full((3, 6), np.nan), np.full((3, 6), 7.0)):
        with pytest.raises(KernelInputError, match=r"^states: "):
            run(np.ones(3), 0.5, 0.26, states=states)
