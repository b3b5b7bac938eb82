"""Levels of a sweep: each a plain sweep whose grid contains that of the one before."""

from hypothesis import given, settings
from hypothesis import strategies as st

from worker.sweep import AXES, SweepSpec
from worker.sweep.levels import WHOLE, cells, coarsest, finest, level, steps_of

LENGTHS = st.integers(1, 400)


@settings(max_examples=25)
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
        assert level(spec, steps_of(spec, part)) == part
        last, steps = part, finest(spec, factor * cells(spec, steps), steps) or steps
    assert (finest(spec, 1e9, steps) or steps) == WHOLE
    assert level(spec, WHOLE) == spec
    assert steps_of(spec, SweepSpec(gamma=[1.0, 1.5], omega=1.0, xi=1.0)) is None
