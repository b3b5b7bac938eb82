"""The states of a plane's starts: drops, and contacts at phase 0 (docs/basins.md, "Planes")."""

import numpy as np
from numpy.typing import NDArray

from kernel.interface import prepare, rest
from kernel.params import STATE_FIELDS
from worker.basins.spec import GridSpec
from worker.spec.contact_models import Contact
from worker.tasks import plate_of


def starts_of(spec: GridSpec, gamma: float, omega: float, xi: float) -> NDArray[np.float64]:
    """The states (rows * columns, 6) of a cell's plane of starts, row by row (see params.STATE_FIELDS)."""
    plane = spec.protocol
    row, column = np.meshgrid(plane.row_values, plane.column_values, indexing="ij")
    if plane.plane == "drop":
        states = drop_states(row, column)
    else:
        states = contact_states(spec.model, (gamma, omega, xi), row, column)
    return states.reshape(-1, len(STATE_FIELDS))


def drop_states(height: NDArray[np.float64], phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """The states (…, 6) of a relaxed spring at rest in the laboratory, released at a plate phase, rad.

    height (…): of the lower mass above the plate, plate amplitudes.
    """
    states = np.zeros((*height.shape, len(STATE_FIELDS)))
    states[..., 0], states[..., 1], states[..., 2] = phase, 1.0, height
    states[..., 3] = np.sin(phase)  # relative to the plate, which moves as cos(phase)
    return states


def contact_states(
    model: Contact,
    cell: tuple[float, float, float],
    elongation: NDArray[np.float64],
    velocity: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The states (…, 6) of a spring whose lower mass sticks to the plate at phase 0.

    cell: gamma, omega, xi. elongation (…): beyond the static one, plate amplitudes; velocity (…): of the
    elongation, times omega, in the same unit.
    """
    gamma, omega, xi = cell
    states = np.zeros((*elongation.shape, len(STATE_FIELDS)))
    plate = plate_of(model, *(np.full(1, value) for value in cell))
    states[..., 2:] = rest(prepare(plate, 0, gamma, omega, xi))
    states[..., 4] += elongation
    states[..., 5] += velocity / omega
    return states
