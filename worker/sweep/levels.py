"""Levels of a sweep from coarse to fine: each is a sweep of its own, whose grid contains that of the last.

A level takes every n-th value of each axis, and the last one. It has the id and the bytes of any sweep with
these values. Pure: the caller measures the cost by which a level fits into a time.
"""

import math
from collections.abc import Iterator
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from worker.sweep.specification import AXES, SweepSpec

#: Steps that a level may take along an axis: divisors of the longest, so that levels can contain each other,
#: and 1.5, two of three values, without which the last level would have twice the cells of the one before.
STEPS: Final = (1, 1.5, 2, 3, 4, 6, 12, 24, 48, 96)
#: The fewest values that a level keeps of an axis with more.
FEWEST: Final = 5
#: Among levels with at least this share of the cells that fit, the one with the most even steps is taken.
NEARLY: Final = 0.9

#: The steps of a level along AXES.
Steps = tuple[float, ...]
WHOLE: Final[Steps] = (1,) * len(AXES)


def level(spec: SweepSpec, steps: Steps) -> SweepSpec:
    """The sweep of every n-th value of each axis, and the last one. Raises SpecInvalid."""
    if steps == WHOLE:
        return spec
    indices = zip(AXES, level_indices(spec, steps), strict=True)
    thinned = {axis: spec.axis_values(axis)[along].tolist() for axis, along in indices}
    return SweepSpec.parse(spec.as_submitted() | thinned)


def is_level(spec: SweepSpec, other: SweepSpec) -> bool:
    """Whether another sweep is a level of this one, or this one itself."""
    values = {axis: getattr(spec, axis) for axis in AXES}
    same = other.model_copy(update=values) == spec
    return same and all(np.isin(other.axis_values(axis), spec.axis_values(axis)).all() for axis in AXES)


def level_indices(spec: SweepSpec, steps: Steps) -> list[NDArray[np.int64]]:
    """The indices of a level's values on the axes of the sweep."""
    along = zip(spec.shape[1:], steps, strict=True)
    return [np.append(np.arange(0, n - 1, step).astype(np.int64), n - 1) for n, step in along]


def cells(spec: SweepSpec, steps: Steps) -> int:
    """Number of cells of a level; each direction counts."""
    directions, *shape = spec.shape
    return directions * math.prod(1 + math.ceil((n - 1) / step) for n, step in zip(shape, steps, strict=True))


def finest(spec: SweepSpec, most: float, within: Steps | None = None) -> Steps | None:
    """A level with even steps and nearly the most cells, up to `most`; None if there is none.

    within: steps of a smaller level that it must contain.
    """
    fewest = 0 if within is None else cells(spec, within)
    fitting = [steps for steps in _all_steps(spec, within) if fewest < cells(spec, steps) <= most]
    enough = NEARLY * max((cells(spec, steps) for steps in fitting), default=0)
    large = [steps for steps in fitting if cells(spec, steps) >= enough]
    return min(large, key=lambda steps: (_unevenness(spec, steps), -cells(spec, steps)), default=None)


def coarsest(spec: SweepSpec) -> Steps:
    """The level with the fewest cells."""
    return min(_all_steps(spec, None), key=lambda steps: cells(spec, steps))


def _all_steps(spec: SweepSpec, within: Steps | None) -> Iterator[Steps]:
    """The steps of all levels, or of those that contain the level `within`."""
    choices = []
    for i, n in enumerate(spec.shape[1:]):
        steps = [step for step in STEPS if step == 1 or n > (FEWEST - 1) * step]
        if within is None:  # multiples of 3 leave more levels in between
            choices.append([step for step in steps if step in (1, 2) or step % 3 == 0])
        else:
            choices.append([step for step in steps if step == 1 or within[i] % step == 0])
    return product(*choices)


def _unevenness(spec: SweepSpec, steps: Steps) -> float:
    """The ratio of the longest step to the shortest, over the axes that a level can thin."""
    long = [step for n, step in zip(spec.shape[1:], steps, strict=True) if n > 2 * (FEWEST - 1)]
    return max(long, default=1) / min(long, default=1)
