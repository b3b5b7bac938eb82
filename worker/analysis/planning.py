"""What settings of a sweep would cost, and how wrong its picture would be: pilot points, computed every way.

The picture of a grid shows each point as the cell nearest to it. At pilot points drawn anywhere in the sweep
the nearest cell of every grid, by every effort, is compared with a computation of the point itself that can
be trusted (`worker.analysis.audit`). All settings are compared at the same points; those that are surely
worse than another are dropped after the first of them, and the one recommended is judged at others.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Cell, Line, Outcome
from worker.analysis.audit import moved, reference
from worker.analysis.deviation import deviations
from worker.analysis.intervals import ENDLESS, bounds
from worker.analysis.model_selection import timed
from worker.spec.time_steps import Cells
from worker.sweep import AXES, SweepSpec
from worker.sweep.levels import Steps, level_indices
from worker.sweep.schema import MODE_ARRAYS
from worker.sweep.task import run_cells

#: Points at which all settings are compared, those for the ones left after it, and others for the one
#: recommended.
FIRST, MORE, FRESH = 40, 60, 100

#: Core-seconds for which a line of cells is repeated: a single run is too short for the clock.
MIN_SECONDS = 0.05


class Setting(NamedTuple):
    """An effort and a grid. `spec` has the effort's windows and the grid of the whole sweep."""

    spec: SweepSpec
    steps: Steps
    seconds: float  # expected


class Measured(NamedTuple):
    """A line of cells beside the same cells with another contact."""

    cost: float  # core-µs per cell per plate period
    true: Line
    deviation: NDArray[np.float64]  # of flights (n,), rad: see `worker.analysis.deviation`
    wrong: NDArray[np.bool_]  # whether outcome or mode differ


class Share(NamedTuple):
    """The share of the plane that a setting shows wrong: found at pilot points, and its bounds."""

    points: int
    share: float
    low: float
    high: float


def plan(
    settings: Sequence[Setting], budget: float | None, tolerance: float | None, seed: int
) -> tuple[list[Share], int]:
    """The share that each setting shows wrong, and the number of the one recommended.

    settings: the most thorough first; its windows are those of the reference, made longer. budget: seconds
    that the recommended one takes at most; tolerance: the share that it shows wrong at most.
    """
    random, thorough = np.random.default_rng(seed), settings[0].spec
    wrong, open_ = _at(settings, _points(random, thorough, FIRST), thorough)
    shares = [_share(each, open_) for each in wrong]
    best = min(share.high for share in shares)
    left = [i for i, share in enumerate(shares) if share.low <= best]
    more, more_open = _at([settings[i] for i in left], _points(random, thorough, MORE), thorough)
    undecided = np.concatenate([open_, more_open])
    for i, each in zip(left, more, strict=True):
        shares[i] = _share(np.concatenate([wrong[i], each]), undecided)
    chosen = recommended(settings, shares, budget, tolerance)
    fresh, fresh_open = _at([settings[chosen]], _points(random, thorough, FRESH), thorough)
    shares[chosen] = _share(fresh[0], fresh_open)
    return shares, chosen


def recommended(
    settings: Sequence[Setting], shares: Sequence[Share], budget: float | None, tolerance: float | None
) -> int:
    """The number of the cheapest setting within budget and tolerance.

    Without a tolerance, or where none is within it, the one that shows least wrong within the budget; where
    none is within the budget, the cheapest.
    """
    numbers = range(len(settings))
    fitting = [i for i in numbers if budget is None or settings[i].seconds <= budget]
    held = [i for i in fitting if tolerance is not None and shares[i].high <= tolerance]
    if held or not fitting:
        return min(held or numbers, key=lambda i: settings[i].seconds)
    return min(fitting, key=lambda i: (shares[i].share, settings[i].seconds))


def frontier(settings: Sequence[Setting], shares: Sequence[Share]) -> list[bool]:
    """Whether no setting that is cheaper shows less wrong."""
    return [
        not any(
            other.seconds < own.seconds and shares[k].share <= shares[i].share
            for k, other in enumerate(settings)
        )
        for i, own in enumerate(settings)
    ]


def measured(spec: SweepSpec, true: SweepSpec) -> Measured:
    """Measure a sweep along gamma against the one that counts as true."""
    record, cost = _along_gamma(spec)
    exact, _ = _along_gamma(true)
    return Measured(cost, exact, deviations(exact, record, spec.micro_flight), _differ(exact, record))


@lru_cache(maxsize=64)
def _along_gamma(spec: SweepSpec) -> tuple[Line, float]:
    gamma = spec.axis_values("gamma")
    omega, xi = (np.full_like(gamma, spec.axis_values(axis)[0]) for axis in ("omega", "xi"))
    [record], cost = timed(spec, [Cells(gamma, omega, xi)], MIN_SECONDS)
    return record, cost


def _points(random: np.random.Generator, spec: SweepSpec, number: int) -> NDArray[np.float64]:
    """Places in the grid, evenly between its cells, (number, 3) in cells along AXES."""
    lengths = np.array(spec.shape[1:], float)
    return np.asarray(np.clip(random.uniform(-0.5, lengths - 0.5, (number, 3)), 0.0, lengths - 1.0))


def _at(
    settings: Sequence[Setting], points: NDArray[np.float64], spec: SweepSpec
) -> tuple[list[NDArray[np.bool_]], NDArray[np.bool_]]:
    """Whether each setting is wrong at the points (n,), and whether the reference of `spec` is undecided."""
    values = [spec.axis_values(axis) for axis in AXES]
    there = [np.interp(points[:, i], np.arange(len(along)), along) for i, along in enumerate(values)]
    cells = [Cell(gamma, omega, xi) for xi, omega, gamma in np.stack(there, axis=1).tolist()]
    starts = [None] * len(cells)
    true, beside = reference(spec, cells, starts), reference(spec, *moved(cells, starts))
    undecided = _differ(true, beside) | np.isin(true.outcome, (Outcome.SETTLING, Outcome.UNRESOLVED))
    shown: dict[tuple[int, ...], Any] = {}
    wrong = []
    for setting in settings:
        nearest = [_nearest(setting, point) for point in points]
        record = _computed(setting.spec, nearest, shown)
        differs = np.any([record[name] != getattr(true, name) for name in MODE_ARRAYS], axis=0)
        wrong.append(differs & ~undecided)
    return wrong, undecided


def _nearest(setting: Setting, point: NDArray[np.float64]) -> tuple[int, ...]:
    """The indices of the cell of a level nearest to a place in the grid."""
    indices = level_indices(setting.spec, setting.steps)
    return tuple(int(along[np.argmin(np.abs(along - at))]) for along, at in zip(indices, point, strict=True))


def _computed(
    spec: SweepSpec, cells: Sequence[tuple[int, ...]], kept: dict[Any, tuple[int, ...]]
) -> dict[str, NDArray[Any]]:
    """Outcomes and modes of cells by a setting's windows; `kept` has those of cells computed before."""
    key = spec.model_dump_json(exclude={*AXES, "name"})
    new = [cell for cell in dict.fromkeys(cells) if (key, cell) not in kept]
    if new:
        xi, omega, gamma = (spec.axis_values(axis)[[cell[i] for cell in new]] for i, axis in enumerate(AXES))
        line = run_cells(spec, gamma, omega, xi, None)
        rows = zip(*(getattr(line, name).tolist() for name in MODE_ARRAYS), strict=True)
        kept.update({(key, cell): row for cell, row in zip(new, rows, strict=True)})
    columns = zip(*(kept[key, cell] for cell in cells), strict=True)
    return {name: np.array(column) for name, column in zip(MODE_ARRAYS, columns, strict=True)}


def _differ(one: Line, other: Line) -> NDArray[np.bool_]:
    differ = [getattr(one, name) != getattr(other, name) for name in MODE_ARRAYS]
    return np.asarray(np.any(differ, axis=0))


def _share(wrong: NDArray[np.bool_], undecided: NDArray[np.bool_]) -> Share:
    certain, open_ = int(np.count_nonzero(wrong)), int(np.count_nonzero(undecided))
    low, high = bounds(certain, certain + open_, len(wrong), ENDLESS)
    return Share(len(wrong), certain / len(wrong), low, high)
