"""Cost of a sweep before it is computed: cells, chunks, stored bytes, core-seconds; and its limits."""

import math
from collections.abc import Iterator
from typing import Any, Final, Literal

from pydantic import Field

from kernel.params import LANES, periods_followed
from worker.schema import bytes_of_map, bytes_per_cell
from worker.spec import SweepSpec
from worker.spec.axes import Strict
from worker.spec.contact_models import CONTACT_MODELS
from worker.spec.errors import Problem, SpecTooLarge
from worker.spec.refine import Refine

#: Limits on one sweep; the settings of a service may set others.
DEFAULT_MAX_CELLS: Final = 20_000_000
DEFAULT_MAX_BYTES: Final = 32 * 2**30
#: Six days of two cores. The largest sweep allowed, at the default window, takes a hundredth of it.
DEFAULT_MAX_CORE_SECONDS: Final = 1e6

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


#: Least and largest share of an adaptive map's cells that are computed, for REFINED_SIDE rows and columns:
#: measured 0.2% to 0.9% by bouncing and 15% to 26% by mode at three xi (`python -m
#: benchmarks.adaptive`). Windows on their finest parts have more.
REFINED_SHARE: Final = {"bouncing": (0.001, 0.03), "mode": (0.02, 0.30)}
REFINED_SIDE: Final = 1025
#: The share falls with the number of rows as its reciprocal to this power, which follows from the dimension
#: of the boundaries: 1 for bouncing, about 1.3 for modes.
REFINED_POWER: Final = {"bouncing": 1.0, "mode": 0.7}
#: With a margin, at most this many times the cells.
REFINED_MARGIN: Final = 2.0
#: A refined cell takes at most this many times as long as one of a full grid: cells settle slowly near
#: boundaries, and settling and chaotic cells are computed rather than filled in.
REFINED_SECONDS: Final = 3.0
#: Core-seconds that storing a tile takes, however few of its cells are computed.
TILE_SECONDS: Final = 0.03


class Cost(Strict):
    """What a sweep will take."""

    cells: int
    chunks: int
    bytes: int = Field(description="of stored arrays before compression; an upper limit for an adaptive map")
    core_seconds: float = Field(description="an upper limit for an adaptive map")
    computed_cells: tuple[int, int] | None = Field(
        None, description="adaptive maps: range of the cells usually computed"
    )
    least_core_seconds: float | None = Field(None, description="adaptive maps: lower limit; null for others")
    longest_core_seconds: float | None = Field(
        None,
        description="upper end: every cell hops as often as any and settles for as long as it may; "
        "null where core_seconds is",
    )
    basis: Literal["measured", "table"] = Field(
        "table", description="measured: from this service's last jobs with the same contact model"
    )
    workers: int = Field(0, description="tasks that the service's workers can run at once now")

    @property
    def upper_core_seconds(self) -> float:
        """The upper end of the estimate, which counts for limits and for the order of jobs."""
        return max(self.core_seconds, self.longest_core_seconds or 0.0)


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
    """Core-seconds of a cell among the busiest that settles for as long as it may."""
    windows = [spec.settle + spec.observe, *_extensions(spec)]
    return longest_period_seconds(spec) * sum(added + periods_followed(spec.observe) for added in windows)


def longest_period_seconds(spec: SweepSpec) -> float:
    """Core-seconds per plate period of the busiest cells."""
    return period_seconds(spec) * spec.model.busiest(*map(spec.axis_values, ("gamma", "omega", "xi")))


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


def estimate(spec: SweepSpec, chunks: int) -> Cost:
    """Cost of a sweep cut into `chunks` chunks, from the table of contact models.

    An adaptive map is known only once computed: its cost is the most that such maps usually take.
    """
    cells, seconds = math.prod(spec.shape), cell_seconds(spec)
    shares = (1.0, 1.0) if spec.refine is None else computed_shares(spec, spec.refine)
    low, high = (math.ceil(share * cells) for share in shares)
    of_map: dict[str, Any] = {}
    if spec.refine is not None:
        of_map = {"computed_cells": (low, high), "least_core_seconds": low * seconds}
        seconds = REFINED_SECONDS * seconds + TILE_SECONDS * chunks / high
    return Cost(
        cells=cells,
        chunks=chunks,
        bytes=high * bytes_per_cell(spec) + (cells - high) * bytes_of_map(spec),
        core_seconds=high * seconds,
        longest_core_seconds=high * max(seconds, longest_cell_seconds(spec)),
        **of_map,
    )


def computed_shares(spec: SweepSpec, refine: Refine) -> tuple[float, float]:
    """Least and largest share of an adaptive map's cells that are usually computed."""
    _, _, omegas, gammas = spec.shape
    side = math.sqrt(omegas * gammas)
    finer = (REFINED_SIDE / side) ** REFINED_POWER[refine.by]
    coarsest = 2.0 / refine.coarsest**2  # a corner and a centre for each block
    low, high = (coarsest + share * finer for share in REFINED_SHARE[refine.by])
    return min(low, 1.0), min(high * (REFINED_MARGIN if refine.margin else 1.0), 1.0)


def check_size(
    cost: Cost,
    *,
    max_cells: int = DEFAULT_MAX_CELLS,
    max_bytes: int = DEFAULT_MAX_BYTES,
    max_core_seconds: float = DEFAULT_MAX_CORE_SECONDS,
) -> None:
    """Raise `SpecTooLarge` for more cells, stored bytes before compression, or core-seconds than these.

    An adaptive map is counted by its computed cells, a range by its upper end.
    """
    cells, computed = (
        (cost.cells, "") if cost.computed_cells is None else (cost.computed_cells[1], "computed ")
    )
    if cells > max_cells:
        rule = f"asks for {cells} {computed}cells; at most {max_cells} are allowed: take fewer values"
        raise SpecTooLarge([Problem("", rule)])
    if cost.bytes > max_bytes:
        per_cell = cost.bytes // cost.cells
        rule = f"asks for {cost.bytes} bytes, {per_cell} per cell; at most {max_bytes} are allowed"
        raise SpecTooLarge([Problem("keep", f"{rule}: keep fewer flights or take fewer values")])
    if cost.upper_core_seconds > max_core_seconds:
        rule = (
            f"asks for up to {cost.upper_core_seconds:,.0f} core-seconds; at most {max_core_seconds:,.0f} "
            "are allowed (max_core_seconds)"
        )
        raise SpecTooLarge([Problem("", f"{rule}: take fewer values, or fewer periods (settle, observe)")])
