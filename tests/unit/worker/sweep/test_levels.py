"""Levels of a sweep: each a plain sweep whose grid contains that of the one before."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from worker.sweep import AXES, SweepSpec
from worker.sweep.levels import WHOLE, cells, coarsest, finest, level

LENGTHS = st.integers(1, 400)


@settings(max_examples=60)
@given(LENGTHS, LENGTHS, st.integers(1, 6), st.lists(st.floats(1.2, 9.0), min_size=4, max_size=4))
def test_levels_contain_each_other_up_to_the_sweep_itself(gamma, omega, xi, factors):
    values = {"gamma": gamma, "omega": omega, "xi": xi}
    spec = SweepSpec(**{axis: [1.0 + i for i in range(n)] for axis, n in values.items()})
    steps, last = coarsest(spec), None
    for factor in [*factors, 1e9]:
        part = level(spec, steps)
        assert cells(spec, steps) == part.shape[1] * part.shape[2] * part.shape[3]
        for axis in AXES:
            along = set(part.axis_values(axis).tolist())
            assert {spec.axis_values(axis)[0], spec.axis_values(axis)[-1]} <= along
            assert along <= set(spec.axis_values(axis).tolist())
            assert last is None or set(last.axis_values(axis).tolist()) <= along
        last, steps = part, finest(spec, factor * cells(spec, steps), steps) or steps
    assert (finest(spec, 1e9, steps) or steps) == WHOLE
    assert level(spec, WHOLE) == spec


def test_a_level_has_the_id_of_any_sweep_with_its_values():
    spec = SweepSpec(gamma={"start": 1, "stop": 3, "num": 41}, omega=0.5, xi=0.1, name="whole")
    part = level(spec, (1, 1, 4))
    plain = SweepSpec(gamma=[1 + 0.2 * i for i in range(11)], omega=0.5, xi=0.1)
    assert part.shape == plain.shape
    assert part.model_copy(update={"gamma": plain.gamma}).job_id("9") == plain.job_id("9")


@pytest.mark.parametrize("first", [0.01, 0.03, 0.05, 0.08])
def test_some_level_takes_most_of_what_fits(first: float):
    spec = SweepSpec(gamma=[1.0 + i for i in range(301)], omega=[1.0 + i for i in range(201)], xi=0.1)
    whole = cells(spec, WHOLE)
    begun = finest(spec, first * whole)
    for share in np.linspace(0.15, 1.0, 40):
        assert cells(spec, finest(spec, share * whole, begun)) > 0.6 * share * whole
