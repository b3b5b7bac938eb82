"""Levels of a sweep from coarse to fine: each is a sweep of its own, whose grid contains that of the last.

A level takes every n-th value of each axis, and the last one. It has the id and the bytes of any sweep with
these values. Pure: the caller measures the cost by which a level fits into a time.
"""

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import NDArray

from worker.sweep.specification import AXES, SweepSpec

#: Steps along an axis of a level that need not contain another. They have many divisors, as a level that
#: contains another divides its step by an integer.
STEPS: Final = (1, 2, 3, 4, 6, 12, 24, 48, 96)
#: A level divides the step of the one within it by up to this, or by more where that leaves an integer: a
#: step of 24 / 7 is seven of 24 values. With integer steps alone a level may have half of the cells that fit.
PARTS: Final = 24
#: A step that is no integer counts as this much unevenness.
UNEVEN: Final = 1.5
#: The fewest values that a level keeps of an axis with more.
FEWEST: Final = 5
#: Among levels with at least this share of the cells that fit, the one with the most even steps is taken.
NEARLY: Final = 0.9

#: The steps of a level along AXES.
Steps = tuple[Fraction, ...]
WHOLE: Final[Steps] = (Fraction(1),) * len(AXES)


def level(spec: SweepSpec, steps: Steps) -> SweepSpec:
    """The sweep of every n-th value of each axis, and the last one. Raises SpecInvalid."""
    if steps == WHOLE:
        return spec
    indices = zip(AXES, level_indices(spec, steps), strict=True)
    thinned = {axis: spec.axis_values(axis)[along].tolist() for axis, along in indices}
    return SweepSpec.parse(spec.as_submitted() | thinned)


def steps_of(spec: SweepSpec, other: SweepSpec) -> Steps | None:
    """The steps with which another sweep is a level of this one; None if it is none."""
    if other.model_copy(update={axis: getattr(spec, axis) for axis in AXES}).canonical() != spec.canonical():
        return None
    steps = [_step_of(spec.axis_values(axis), other.axis_values(axis)) for axis in AXES]
    return tuple(step for step in steps if step) if all(steps) else None


def level_indices(spec: SweepSpec, steps: Steps) -> list[NDArray[np.int64]]:
    """The indices of a level's values on the axes of the sweep."""
    return [_indices(n, step) for n, step in zip(spec.shape[1:], steps, strict=True)]


def cells(spec: SweepSpec, steps: Steps) -> int:
    """Number of cells of a level; each direction counts."""
    directions, *shape = spec.shape
    return directions * math.prod(_values(n, step) for n, step in zip(shape, steps, strict=True))


def finest(spec: SweepSpec, most: float, within: Steps | None = None) -> Steps | None:
    """A level with even steps and nearly the most cells, up to `most`; None if there is none.

    within: steps of a smaller level that it must contain.
    """
    choices, count = _levels(spec, within)
    fewest = 0 if within is None else cells(spec, within)
    fitting = (count > fewest) & (count <= most)
    enough = NEARLY * np.max(count, where=fitting, initial=0)
    large = [_steps(choices, at) for at in np.argwhere(fitting & (count >= enough))]
    return min(large, key=lambda steps: (_unevenness(spec, steps), -cells(spec, steps)), default=None)


def coarsest(spec: SweepSpec, within: Steps | None = None) -> Steps:
    """The level with the fewest cells. within: steps, not WHOLE, of a level that it must contain."""
    choices, count = _levels(spec, within)
    larger = count > (0 if within is None else cells(spec, within))
    fewest = np.min(count, where=larger, initial=np.max(count))
    return _steps(choices, np.argwhere(larger & (count == fewest))[0])


def _levels(spec: SweepSpec, within: Steps | None) -> tuple[list[list[Fraction]], NDArray[np.int64]]:
    """The steps that levels may take along each axis, and the cells of each level."""
    lengths = spec.shape[1:]
    if within is None:
        choices = [
            [Fraction(step) for step in STEPS if step == 1 or n > (FEWEST - 1) * step] for n in lengths
        ]
    else:
        choices = [_parts(n, step) for n, step in zip(lengths, within, strict=True)]
    pairs = zip(lengths, choices, strict=True)
    counts = [np.array([_values(n, step) for step in steps]) for n, steps in pairs]
    return choices, np.asarray(spec.shape[0] * math.prod(np.ix_(*counts)))


def _steps(choices: list[list[Fraction]], at: Iterable[int]) -> Steps:
    return tuple(steps[i] for steps, i in zip(choices, at, strict=True))


def _parts(n: int, step: Fraction) -> list[Fraction]:
    """The steps of levels that contain one with this step along an axis with n values."""
    parts = [step / part for part in range(1, int(step) + 1)]
    kept = [part for i, part in enumerate(parts) if i < PARTS or part.denominator == 1]
    return [*(part for part in kept if _values(n, part) < n), Fraction(1)]


def _step_of(values: NDArray[np.float64], kept: NDArray[np.float64]) -> Fraction | None:
    """The step with which a level keeps these values of an axis; None if there is none."""
    steps = (Fraction(step, part) for step in STEPS for part in range(1, step + 1))
    alike = (step for step in steps if _values(len(values), step) == len(kept))
    return next((step for step in alike if np.array_equal(values[_indices(len(values), step)], kept)), None)


def _indices(n: int, step: Fraction) -> NDArray[np.int64]:
    return np.append(np.arange(_values(n, step) - 1) * step.numerator // step.denominator, n - 1)


def _values(n: int, step: Fraction) -> int:
    """Number of values that a level takes of an axis with n."""
    return 1 + math.ceil((n - 1) / step)


def _unevenness(spec: SweepSpec, steps: Steps) -> float:
    """The ratio of the longest step to the shortest, over the axes that a level can thin."""
    long = [step for n, step in zip(spec.shape[1:], steps, strict=True) if n > 2 * (FEWEST - 1)]
    fractions = sum(step.denominator > 1 for step in long)
    return float(max(long, default=1) / min(long, default=1)) * UNEVEN**fractions
