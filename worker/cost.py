"""Cost of a sweep before it is computed: cells, chunks, stored bytes, core-seconds; and its limits."""

import math
from typing import Final, Literal

from pydantic import Field

from worker.schema import bytes_per_cell
from worker.spec import SweepSpec
from worker.spec.axes import Strict
from worker.spec.contact_models import CONTACT_MODELS
from worker.spec.errors import Problem, SpecTooLarge

#: Limits on one sweep where the settings of a service set no others.
DEFAULT_MAX_CELLS: Final = 20_000_000
DEFAULT_MAX_BYTES: Final = 32 * 2**30


class Cost(Strict):
    """What a sweep will take."""

    cells: int
    chunks: int
    bytes: int = Field(description="of stored arrays before compression")
    core_seconds: float
    basis: Literal["measured", "table"] = Field(
        "table", description="measured: by the speed of this service's last jobs with the same contact model"
    )


def cell_seconds(spec: SweepSpec) -> float:
    """Core-seconds per cell of a sweep, from the table of contact models."""
    gamma, omega = spec.axis_values("gamma"), spec.axis_values("omega")
    base = CONTACT_MODELS[spec.model.kind].cost_us
    period_us = spec.model.cost_us(base, gamma, omega, ramp=spec.ramp_axis is not None)
    return period_us * 1e-6 * (spec.settle + spec.observe)


def estimate(spec: SweepSpec, chunks: int) -> Cost:
    """Cost of a sweep that is cut into `chunks` chunks, from the table of contact models."""
    cells = math.prod(spec.shape)
    return Cost(
        cells=cells,
        chunks=chunks,
        bytes=cells * bytes_per_cell(spec),
        core_seconds=cells * cell_seconds(spec),
    )


def check_size(cost: Cost, *, max_cells: int = DEFAULT_MAX_CELLS, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
    """Raise `SpecTooLarge` if there are more than `max_cells` cells or `max_bytes` stored bytes."""
    if cost.cells > max_cells:
        raise SpecTooLarge(
            [Problem("", f"asks for {cost.cells} cells; at most {max_cells} are allowed: take fewer values")]
        )
    if cost.bytes > max_bytes:
        per_cell = cost.bytes // cost.cells
        rule = f"asks for {cost.bytes} bytes, {per_cell} per cell; at most {max_bytes} are allowed"
        raise SpecTooLarge([Problem("keep", f"{rule}: keep fewer flights or take fewer values")])
