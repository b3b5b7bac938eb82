"""Room: which time steps a sweep may ask of `stepped`: stable in every cell, and not too many.

Imports numpy and kernel.step_limits, which needs no numba, and its neighbours in worker.
"""

from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.step_limits import (
    MOST_STEPS_PER_PERIOD,
    Scheme,
    largest_stable_step,
    stable_steps_per_contact,
    steps_per_period,
)
from worker.spec.contact_models import Stepped, penetration_of
from worker.spec.errors import BrokenRuleError

#: A worker takes some two minutes for this, and cannot be stopped within a cell.
MOST_STEPS_PER_CELL: Final = 10_000_000_000


class Cells(NamedTuple):
    """Cells that are worst for any steps; arrays (n,)."""

    gamma: NDArray[np.float64]
    omega: NDArray[np.float64]
    xi: NDArray[np.float64]


def corners(gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64]) -> Cells:
    """The (up to) eight corners of a grid.

    Both numbers of steps asked of `kernel.step_limits` rise or fall with each parameter all the way,
    the contact's depth included where a rest length makes it go like Omega**2/Gamma: none is
    larger inside the grid than at every corner.
    """
    ends = (sorted({float(axis[0]), float(axis[-1])}) for axis in (gamma, omega, xi))
    table = np.array(list(product(*ends)))
    return Cells(table[:, 0], table[:, 1], table[:, 2])


def check_steps(model: Stepped, cells: Cells, periods: int) -> None:
    """Raise BrokenRuleError unless `model` is stable in all `cells` and takes no more steps than it may."""
    depth = penetration_of(model, cells.gamma, cells.omega)
    least = _fewest_stable(model, cells, depth)
    most = min(MOST_STEPS_PER_PERIOD, MOST_STEPS_PER_CELL // periods)
    asked = int(
        np.max(steps_per_period(model.restitution, depth, model.steps_per_contact, adhesive=model.adhesive))
    )
    if asked <= most:
        return
    over = f" over {periods} periods" if most < MOST_STEPS_PER_PERIOD else ""
    rule = f"asks for {asked:.3g} steps in a plate period, at most {most:.3g} are allowed{over}"
    fitting = model.steps_per_contact * most // (asked + 1)
    if fitting >= least:
        raise BrokenRuleError("model.steps_per_contact", f"{rule}; {fitting} would do")
    field = "penetration" if model.rest_length is None else "rest_length"
    deeper = _rounded_up(getattr(model, field) * asked / most)
    raise BrokenRuleError(f"model.{field}", f"{rule}; {deeper:g} would do")


def stated(model: Stepped, cells: Cells) -> dict[str, float]:
    """What a store says of its time steps, over all cells: the longest (rad), and the limit of stability.

    The limit is that of contact, spring and dashpot together in the worst cell, as a step (rad) and as
    `steps_per_contact`.
    """
    depth = penetration_of(model, cells.gamma, cells.omega)
    steps = steps_per_period(model.restitution, depth, model.steps_per_contact, adhesive=model.adhesive)
    limit = largest_stable_step(
        cells.omega, cells.xi, model.restitution, depth,
        adhesive=model.adhesive, scheme=Scheme[model.scheme.upper()],
    )  # fmt: skip
    return {
        "longest_step": float(2.0 * np.pi / np.min(steps)),
        "stable_below": float(np.min(limit)),
        "fewest_stable_steps_per_contact": _fewest_stable(model, cells, depth),
    }


def _fewest_stable(model: Stepped, cells: Cells, depth: NDArray[np.float64]) -> int:
    """The fewest steps a contact that are stable everywhere; raises if `model` has fewer."""
    scheme = Scheme[model.scheme.upper()]
    fewest = stable_steps_per_contact(
        cells.omega, cells.xi, model.restitution, depth, adhesive=model.adhesive, scheme=scheme
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
    """A number a little above, of two digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(np.ceil(value / digit + 0.5) * digit)
