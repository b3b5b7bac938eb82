"""Cost against accuracy of the contact models: the measured table, and which model to take."""

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, Final

from pydantic import BaseModel, Field

from service.jobs.on_demand import Caller
from worker.analysis import work_precision
from worker.analysis.work_precision import Measurement

#: What each purpose's errors are measured from.
REFERENCES: Final = {
    "adhesive": "exact soft contact, adhesive, d = 1e-3, e = 0.01: for studies of this contact",
    "nonadhesive": "exact soft contact, nonadhesive, d = 1e-3, e = 0.01: for studies of this contact",
    "plate": "exact soft contact, nonadhesive, d = 1e-7, e = 1e-6: for studies of a hard plate",
}


class Tradeoff(BaseModel):
    """Costs in core-µs per cell per plate period, errors in rad of flight time."""

    rows: list[Measurement]
    cells: int = Field(description="in the comparison; errors are of those whose reference is periodic")
    periods: int = Field(description="plate periods per cell")
    micro_flight: float = Field(description="rad; shorter flights are left out")
    references: dict[str, str] = Field(description="what the errors of each purpose are measured from")
    advice: str


def submit(workers: Caller) -> list[Future[Measurement]]:
    """Start the measurements on the workers, one future per row of the table."""
    return [workers.call(work_precision.measure, setup) for setup in work_precision.SETUPS]


def table(rows: list[Measurement]) -> Tradeoff:
    """The table made of measurements."""
    return Tradeoff(
        rows=rows,
        cells=len(work_precision.LINES) * work_precision.CELLS_PER_LINE,
        periods=work_precision.SETTLE + work_precision.OBSERVE,
        micro_flight=work_precision.MICRO_FLIGHT,
        references=REFERENCES,
        advice=advice(rows),
    )


def advice(rows: Sequence[Measurement]) -> str:
    """Which model to take for which purpose, with the costs and errors just measured."""
    soft = _row(rows, "adhesive", model="soft")
    rigid, hard = _row(rows, "adhesive", model="rigid"), _row(rows, "plate", model="rigid")
    stepped = _row(rows, "adhesive", model="stepped", scheme="verlet", steps_per_contact=20)
    ball = _row(rows, "adhesive", model="ball", locked_only=True)
    return (
        f"Take rigid for a hard plate ({hard.cost:.1g} µs per plate period, {rigid.error:.0e} rad from a "
        "contact 1e-3 deep); soft where the contact itself matters, its depth, its rebound, its small "
        f"flights ({soft.cost:.1f} µs, exact, and little more for a stiffer contact); ball only where "
        f"the dashpot locks the spring ({ball.cost:.1g} µs); stepped to compare with studies that took "
        f"time steps ({stepped.cost / soft.cost:.0f} times the cost of soft, for {stepped.error:.0e} rad at "
        "20 steps per contact); and auto to choose the model on the cells of your own sweep."
    )


def _row(rows: Sequence[Measurement], purpose: str, **settings: Any) -> Any:
    """The first such row; Any, because the models of the advice always have a cost and an error."""
    settings = {"purpose": purpose, **settings}
    return next(row for row in rows if all(getattr(row, name) == value for name, value in settings.items()))
