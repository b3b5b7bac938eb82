"""A toy contact model with all parts of a new one. The spring never leaves the plate.

The parts: its module (this one) with the functions of a kernel, its fields, and its row of the table.
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.interface import Phase, PlatePhase, State, contact, contact_force, flies, flight, prepare, rest
from kernel.numerics.first_root import HORIZON
from kernel.numerics.jit import jit
from kernel.params import check_arrays
from worker.spec.contact_models import ContactFields, ContactModel


class GluedPlate(NamedTuple):
    """The plate under each cell of a line."""

    restitution: NDArray[np.float64]  # (n,) without meaning here


class Glued(NamedTuple):
    """One cell's constants."""

    gravity: float  # 1/Gamma


def plate(*, restitution: NDArray[np.float64]) -> GluedPlate:
    check_arrays({"restitution": restitution})
    return GluedPlate(restitution)


@prepare.register(GluedPlate)
@jit
def _prepare(plate: GluedPlate, i: int, gamma: float, omega: float, xi: float) -> Glued:
    return Glued(1.0 / gamma)


@rest.register(Glued)
@jit
def _rest(g: Glued) -> State:
    return State(0.0, 0.0, 0.0, 0.0)


@flies.register(Glued)
@jit
def _flies(g: Glued, phi: PlatePhase, state: State) -> bool:
    return False


@contact.register(Glued)
@jit
def _contact(g: Glued, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    return Phase(horizon, HORIZON, False, State(0.0, 0.0, phi.cos, 0.0), 1)


@flight.register(Glued)
@jit
def _flight(g: Glued, phi: PlatePhase, state: State, horizon: float, budget: int) -> Phase:
    return Phase(horizon, HORIZON, False, State(0.0, 0.0, 0.0, 0.0), 1)


@contact_force.register(Glued)
@jit
def _contact_force(g: Glued, phi: PlatePhase, state: State) -> float:
    return g.gravity - phi.cos


class GluedFields(ContactFields):
    """Its fields in a specification."""

    kind: Literal["glued"]
    colour: Literal["red", "blue"] = "red"

    def plate_arguments(self, gamma: Any, omega: Any, xi: Any) -> dict[str, Any]:
        return {"restitution": np.zeros_like(xi)}


ROW = ContactModel(GluedFields, "toy_model", 0.01, "glued contact")
