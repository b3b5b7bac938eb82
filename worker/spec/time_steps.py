"""Time steps of the model `stepped`: they must be stable in every cell of a sweep, and not too many."""

from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.step_limits import (
    MOST_STEPS_PER_PERIOD,
    largest_stable_step,
    stable_steps_per_contact,
    steps_per_period,
)
from worker.spec.contact_models import Stepped, penetration_of
from worker.spec.errors import BrokenRuleError
from worker.spec.specification import Specification

#: About two minutes of computing: a worker checks the cancel flag only between cells.
MOST_STEPS_PER_CELL: Final = 10_000_000_000


class Cells(NamedTuple):
    """Cells, one after the other; arrays (n,)."""

    gamma: NDArray[np.float64]
    omega: NDArray[np.float64]
    xi: NDArray[np.float64]


def corners(spec: Specification) -> Cells:
    """The (up to) eight corners of a specification's grid.

    Both numbers of steps in `kernel.step_limits` are monotonic in each parameter, also where a rest length
    makes the contact's depth proportional to Omega**2/Gamma. So the largest number of a grid is at a corner.
    """
    ends = (sorted({*spec.axis_values(axis)[[0, -1]].tolist()}) for axis in Cells._fields)
    return Cells(*np.array(list(product(*ends))).T)


def check_steps(model: Stepped, cells: Cells, periods: int) -> None:
    """Raise BrokenRuleError if `model` is unstable in any of `cells` or takes too many steps in `periods`."""
    depth = penetration_of(model, cells.gamma, cells.omega)
    min_per_contact = _fewest_stable(model, cells, depth)
    max_per_period = min(MOST_STEPS_PER_PERIOD, MOST_STEPS_PER_CELL // periods)
    steps = steps_per_period(model.restitution, depth, model.steps_per_contact, adhesive=model.adhesive)
    per_period = int(np.max(steps))
    if per_period <= max_per_period:
        return
    over = f" over {periods} periods" if max_per_period < MOST_STEPS_PER_PERIOD else ""
    rule = (
        f"asks for {per_period:.3g} steps in a plate period, at most {max_per_period:.3g} are allowed{over}"
    )
    fitting = model.steps_per_contact * max_per_period // (per_period + 1)
    if fitting >= min_per_contact:
        raise BrokenRuleError("model.steps_per_contact", f"{rule}; {fitting} works")
    field = "penetration" if model.rest_length is None else "rest_length"
    deeper = _rounded_up(getattr(model, field) * per_period / max_per_period)
    raise BrokenRuleError(f"model.{field}", f"{rule}; {deeper:g} works")


def stated(model: Stepped, cells: Cells) -> dict[str, float]:
    """A store's attribute `time_steps`: the longest step of all cells (rad) and the limit of stability.

    The limit applies to contact, spring and dashpot together in the worst cell, as a step (rad) and as
    `steps_per_contact`. Raises BrokenRuleError if `model` is unstable in any of `cells`.
    """
    depth = penetration_of(model, cells.gamma, cells.omega)
    steps = steps_per_period(model.restitution, depth, model.steps_per_contact, adhesive=model.adhesive)
    limit = largest_stable_step(
        cells.omega, cells.xi, model.restitution, depth,
        adhesive=model.adhesive, scheme=model.scheme,
    )  # fmt: skip
    return {
        "longest_step": float(2.0 * np.pi / np.min(steps)),
        "stable_below": float(np.min(limit)),
        "fewest_stable_steps_per_contact": _fewest_stable(model, cells, depth),
    }


def _fewest_stable(model: Stepped, cells: Cells, depth: NDArray[np.float64]) -> int:
    """The fewest stable steps per contact, over all cells; raises BrokenRuleError if `model` has fewer."""
    fewest = stable_steps_per_contact(
        cells.omega, cells.xi, model.restitution, depth, adhesive=model.adhesive, scheme=model.scheme
    )
    worst = int(np.argmax(fewest))
    if model.steps_per_contact < fewest[worst]:
        where = ", ".join(f"{name} {values[worst]:g}" for name, values in cells._asdict().items())
        rule = (
            f"must be at least {fewest[worst]}, not {model.steps_per_contact}: longer steps are unstable "
            f"with '{model.scheme}' at {where}"
        )
        raise BrokenRuleError("model.steps_per_contact", rule)
    return int(fewest[worst])


def _rounded_up(value: float) -> float:
    """The value rounded up to two significant digits, by at least half a unit of the second."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(np.ceil(value / digit + 0.5) * digit)
