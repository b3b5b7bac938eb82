"""The contact models by short names, and their plates in one call: for tests and benchmarks of the kernel."""

from enum import IntEnum
from typing import Any

import numpy as np

from kernel import line
from kernel.models import ball, rigid, soft, stepped
from kernel.params import Line

#: e, d, Omega, xi of hard contacts without adhesion. In the first four, many cells of Gamma from 1 to 6 did
#: not end.
HARD_CONTACTS = (
    (1e-6, 1e-8, 1.0, 0.05),
    (1e-6, 1e-7, 1.0, 0.05),
    (1e-5, 1e-7, 1.0, 0.05),
    (1e-4, 1e-6, 0.5, 0.26),
    (1e-8, 1e-8, 1.0, 0.05),
    (1e-8, 1e-2, 1.0, 0.05),
    (1e-12, 1e-8, 1.0, 0.05),
)


class Model(IntEnum):
    """The contact models."""

    SOFT = 0
    STEPPED = 1
    RIGID = 2
    BALL = 3


def plate_of(
    model: Model,
    restitution: np.ndarray,
    penetration: np.ndarray,
    adhesive: bool = True,
    steps_per_contact: int = 20,
    scheme: str = "verlet",
    events: str = "located",
) -> Any:
    """The plate of n cells, from arrays (n,)."""
    module = {Model.SOFT: soft, Model.STEPPED: stepped, Model.RIGID: rigid, Model.BALL: ball}[model]
    arguments: dict[str, Any] = {"restitution": restitution}
    if model in (Model.SOFT, Model.STEPPED):
        arguments |= {"penetration": penetration, "adhesive": adhesive}
    if model is Model.STEPPED:
        arguments |= {"steps_per_contact": steps_per_contact, "scheme": scheme, "events": events}
    return module.plate(**arguments)


#: The arguments of `plate_of` other than the model.
CONTACT = ("restitution", "penetration", "adhesive", "steps_per_contact", "scheme", "events")


def run_line(gamma: Any, omega: Any, xi: Any, *, model: Model, **options: Any) -> Line:
    """Call `kernel.line.run_line` with the plate of a model."""
    contact = {name: options.pop(name) for name in CONTACT if name in options}
    return line.run_line(gamma, omega, xi, plate=plate_of(model, **contact), **options)
