"""The plan of a sweep: what settings would cost, and how wrong their pictures would be, from pilot points.

The picture of a grid shows each point as the nearest cell. Pilot points are drawn anywhere in the sweep. The
nearest cell of every grid, by every effort, is compared with the reference of the point itself
(`worker.analysis.audit`). All settings are compared at the same first points. Those that are surely worse
than another are dropped. Those that may be recommended are judged at fresh points.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.params import Cell
from worker.analysis.audit import reference
from worker.analysis.intervals import BELOW, ENDLESS, bounds
from worker.sweep import AXES, SweepSpec
from worker.sweep.levels import Steps, level_indices
from worker.sweep.schema import MODE_ARRAYS
from worker.sweep.task import run_cells

#: Points at which all settings are compared, more points for the settings left, and fresh points for the
#: candidates; the most candidates that keep to a tolerance.
FIRST, MORE, FRESH, CANDIDATES = 40, 60, 100, 4


class Setting(NamedTuple):
    """An effort and a grid."""

    spec: SweepSpec  # with the effort's windows, and the grid of the whole sweep
    steps: Steps
    seconds: float  # expected
    bytes: int  # stored, before compression
    effort: str


class Share(NamedTuple):
    """The share of the plane that a setting shows wrong: as found at pilot points, and its bounds."""

    points: int
    share: float
    low: float
    high: float


def plan(
    settings: Sequence[Setting], budget: float | None, tolerance: float | None, seed: int
) -> tuple[list[Share], int]:
    """The share that each setting shows wrong, and the index of the recommended one.

    settings: the most thorough first; the reference has its windows, made longer. budget, tolerance: limits
    on the recommended setting's seconds and on its share.
    """
    random, thorough = np.random.default_rng(seed), settings[0].spec
    wrong, undecided = _wrong_at(random, FIRST, settings, thorough)
    shares = [_share(first, undecided) for first in wrong]
    best = min(share.high for share in shares)
    left = [i for i, share in enumerate(shares) if share.low <= best]
    more, more_undecided = _wrong_at(random, MORE, [settings[i] for i in left], thorough)
    undecided = np.concatenate([undecided, more_undecided])
    for i, second in zip(left, more, strict=True):
        shares[i] = _share(np.concatenate([wrong[i], second]), undecided)
    chosen = candidates(settings, shares, budget, tolerance)
    fresh, undecided = _wrong_at(random, FRESH, [settings[i] for i in chosen], thorough)
    for i, third in zip(chosen, fresh, strict=True):
        shares[i] = _share(third, undecided, looks=len(chosen))
    return shares, recommended(chosen, shares, tolerance)


def candidates(
    settings: Sequence[Setting], shares: Sequence[Share], budget: float | None, tolerance: float | None
) -> list[int]:
    """The indices of the cheapest settings within budget and tolerance, the cheapest first, and the surest.

    If there is no tolerance, or no setting keeps it: all within the budget that are not surely worse than
    another of them, so that the best is found by numbers of one sample. If no setting keeps the budget: the
    cheapest.
    """
    by_cost = sorted(range(len(settings)), key=lambda i: settings[i].seconds)
    fitting = [i for i in by_cost if budget is None or settings[i].seconds <= budget]
    held = [i for i in fitting if tolerance is not None and shares[i].high <= tolerance]
    best = min((shares[i].high for i in fitting), default=0.0)
    surest = [min(held[CANDIDATES - 1 :], key=lambda i: shares[i].high)] if len(held) >= CANDIDATES else []
    return held[: CANDIDATES - 1] + surest or [i for i in fitting if shares[i].low <= best] or by_cost[:1]


def recommended(chosen: Sequence[int], shares: Sequence[Share], tolerance: float | None) -> int:
    """The first candidate that keeps the tolerance at fresh points too, or the one that shows least wrong."""
    held = [i for i in chosen if tolerance is not None and shares[i].high <= tolerance]
    return held[0] if held else min(chosen, key=lambda i: shares[i].high)


def frontier(settings: Sequence[Setting], shares: Sequence[Share]) -> list[bool]:
    """For each setting, whether every cheaper one shows more wrong."""
    costs = [(setting.seconds, share.share) for setting, share in zip(settings, shares, strict=True)]
    return [not any(s < seconds and w <= wrong for s, w in costs) for seconds, wrong in costs]


def _wrong_at(
    random: np.random.Generator, number: int, settings: Sequence[Setting], spec: SweepSpec
) -> tuple[list[NDArray[np.bool_]], NDArray[np.bool_]]:
    """Whether each setting is wrong at n random points, and whether the reference of `spec` is undecided."""
    points = random.uniform(0.0, np.array(spec.shape[1:]) - 1.0, (number, 3))  # in cells along AXES
    axes = [spec.axis_values(axis) for axis in AXES]
    values = [np.interp(points[:, i], np.arange(len(along)), along) for i, along in enumerate(axes)]
    cells = [Cell(gamma, omega, xi) for xi, omega, gamma in np.stack(values, axis=1).tolist()]
    true, undecided = reference(spec, cells, [None] * len(cells))
    shown: dict[tuple[int, ...], Any] = {}
    wrong = []
    for setting in settings:
        indices = zip(level_indices(setting.spec, setting.steps), points.T, strict=True)
        nearest = [along[np.abs(along - x[:, None]).argmin(axis=1)].tolist() for along, x in indices]
        record = _computed(setting.spec, list(zip(*nearest, strict=True)), shown)
        differs = np.any([record[name] != getattr(true, name) for name in MODE_ARRAYS], axis=0)
        wrong.append(differs & ~undecided)
    return wrong, undecided


def _computed(
    spec: SweepSpec, cells: Sequence[tuple[int, ...]], cache: dict[Any, tuple[int, ...]]
) -> dict[str, NDArray[Any]]:
    """Outcomes and modes of cells by a setting's windows; `cache` keeps those computed before."""
    key = spec.model_dump_json(exclude={*AXES, "name"})
    new = [cell for cell in dict.fromkeys(cells) if (key, cell) not in cache]
    if new:
        xi, omega, gamma = (spec.axis_values(axis)[[cell[i] for cell in new]] for i, axis in enumerate(AXES))
        line = run_cells(spec, (gamma, omega, xi), None)
        rows = zip(*(getattr(line, name).tolist() for name in MODE_ARRAYS), strict=True)
        cache.update({(key, cell): row for cell, row in zip(new, rows, strict=True)})
    columns = zip(*(cache[key, cell] for cell in cells), strict=True)
    return {name: np.array(column) for name, column in zip(MODE_ARRAYS, columns, strict=True)}


def _share(wrong: NDArray[np.bool_], undecided: NDArray[np.bool_], looks: int = 1) -> Share:
    """The share of points that are wrong; the upper bounds of all `looks` hold together."""
    certain = int(np.count_nonzero(wrong))
    doubtful = certain + int(np.count_nonzero(undecided))
    low, high = bounds(certain, doubtful, len(wrong), ENDLESS, below=BELOW / looks)
    return Share(len(wrong), certain / len(wrong), low, high)
