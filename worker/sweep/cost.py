"""Cost of a sweep before it is computed: chunks, stored bytes, core-seconds."""

import math
from collections.abc import Iterator
from typing import Final

from kernel.params import LANES, periods_followed
from worker.spec.contact_models import CONTACT_MODELS
from worker.study.plan import Cost, Plan
from worker.sweep.schema import bytes_per_cell
from worker.sweep.specification import SweepSpec

#: Share of the cells that still settle at the end of their window, and the share of those that still do after
#: each doubling of the periods: of 24,000 random cells 5.3% after 300 periods, 1.9% after 600, 0.7%
#: after 1,200, 0.2% after 2,400 (`python -m benchmarks.settling`).
SETTLING_SHARE: Final = 0.053
STILL_SETTLING_SHARE: Final = 0.35

#: Share of the cells whose window shows no mode and which are followed beyond it, of 24,000 random cells.
FOLLOWED_SHARE: Final = 0.25

#: Cost of a cell with Lyapunov exponents relative to one without, both computed one by one, at most
#: (`python -m benchmarks.exponents`).
WITH_EXPONENTS: Final = 1.5


def cell_seconds(spec: SweepSpec, *, alone: bool = False) -> float:
    """Mean core-seconds per cell of a sweep, from the table of contact models.

    alone: as in `period_seconds`.
    """
    followed = periods_followed(spec.observe)
    periods, share = spec.settle + spec.observe + FOLLOWED_SHARE * followed, SETTLING_SHARE
    for added in _extensions(spec):
        periods, share = periods + share * (added + followed), share * STILL_SETTLING_SHARE
    share = CONTACT_MODELS[spec.model.kind].early if spec.ends_early else 1.0
    return share * period_seconds(spec, alone=alone) * periods


def longest_cell_seconds(spec: SweepSpec) -> float:
    """Core-seconds of a cell that settles until settle_until, from the table of contact models."""
    windows = [spec.settle + spec.observe, *_extensions(spec)]
    return period_seconds(spec) * sum(added + periods_followed(spec.observe) for added in windows)


def period_seconds(spec: SweepSpec, *, alone: bool = False) -> float:
    """Core-seconds per cell and computed plate period of a sweep, from the table of contact models.

    alone: for a cell computed by itself, as in a refinement.
    """
    gamma, omega = spec.axis_values("gamma"), spec.axis_values("omega")
    model = CONTACT_MODELS[spec.model.kind]
    at_once = 1 if alone else cells_at_once(spec)
    period_us = spec.model.cost_us(model.cost_us, gamma, omega, at_once=at_once)
    if spec.ramp_axis is not None and (at_once > 1 or not spec.model.in_lanes):
        period_us *= model.ramp
    if spec.exponents:
        period_us *= WITH_EXPONENTS
    return period_us * 1e-6


def cells_at_once(spec: SweepSpec) -> int:
    """Cells, or lines of a ramp, that the kernel computes side by side: fewer leave lanes idle."""
    if not spec.model.in_lanes or spec.exponents:
        return 1
    return LANES if spec.ramp_axis is None else min(LANES, lines_of(spec))


def lines_of(spec: SweepSpec) -> int:
    """Lines of a ramp, both directions counted once."""
    _, *grid = spec.shape
    return math.prod(grid) // len(spec.axis_values(spec.ramp_axis)) if spec.ramp_axis else math.prod(grid)


def _extensions(spec: SweepSpec) -> Iterator[int]:
    """Plate periods of each extension of a cell that is still settling, as in `kernel.cell.extend`."""
    taken = spec.settle + spec.observe
    while (added := min(taken, (spec.settle_until or 0) - taken)) >= spec.observe:
        yield added
        taken += added


def estimate(spec: SweepSpec, plan: Plan) -> Cost:
    """Cost of a sweep, from the table of contact models."""
    cells = math.prod(spec.shape)
    return Cost(
        cells=cells,
        chunks=len(plan),
        bytes=cells * bytes_per_cell(spec),
        core_seconds=cells * cell_seconds(spec),
        longest_core_seconds=None if spec.settle_until is None else cells * longest_cell_seconds(spec),
    )
