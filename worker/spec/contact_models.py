"""Room: how a specification names its contact model, and what that means cell by cell.

Imports pydantic, numpy, what of the kernel needs no numba, and its neighbours in worker.
"""

from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from kernel.params import Model
from kernel.restitution import restitution_of as spring_restitution
from worker.spec.axes import NUMBER, WHOLE, Strict
from worker.spec.errors import BrokenRuleError, describe, did_you_mean, one_of

#: Contact depths delta_c/A between these are what double precision carries.
MIN_PENETRATION: Final = 1e-12
MAX_PENETRATION: Final = 1.0
DEFAULT_PENETRATION: Final = 1e-3

#: A law that never pulls reaches e = 0 only as its damping grows without bound, and under the
#: other one the contact then has no end, which leaves time steps nothing to be a part of.
MIN_RESTITUTION: Final = 1e-6

#: The exact solution's own flights are good to about this, rad.
MIN_TOLERANCE: Final = 1e-9

MAX_STEPS_PER_CONTACT: Final = 1_000_000

_Restitution = Annotated[float, Field(ge=0.0, le=1.0), NUMBER]


class _SoftContact(Strict):
    """What every model with a spring-dashpot contact is told."""

    kind: str
    restitution: _Restitution = 0.01
    penetration: Annotated[float, Field(ge=MIN_PENETRATION, le=MAX_PENETRATION), NUMBER] | None = None
    rest_length: Annotated[float, Field(gt=0.0, le=1e12), NUMBER] | None = None
    adhesive: bool = True

    @model_validator(mode="before")
    @classmethod
    def _default_penetration(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("penetration") is None and data.get("rest_length") is None:
            return {**data, "penetration": DEFAULT_PENETRATION}
        return data

    @model_validator(mode="after")
    def _rules(self) -> "_SoftContact":
        if self.penetration is not None and self.rest_length is not None:
            rule = "must be absent or null where penetration is given: each alone sets the contact's depth"
            raise BrokenRuleError("rest_length", rule)
        if not self.adhesive and self.restitution < MIN_RESTITUTION:
            rule = (
                f"must be at least {MIN_RESTITUTION:g} where adhesive is false, "
                f"not {self.restitution!r}: without pull, less needs damping without bound"
            )
            raise BrokenRuleError("restitution", rule)
        return self


class Soft(_SoftContact):
    """Spring-dashpot contact, solved exactly."""

    kind: Literal["soft"] = "soft"


class Stepped(_SoftContact):
    """The same contact by fixed time steps; what a sweep may ask of them, see worker.spec.time_steps."""

    kind: Literal["stepped"]
    steps_per_contact: Annotated[int, Field(ge=1, le=MAX_STEPS_PER_CONTACT), WHOLE] = 20
    scheme: Literal["verlet", "euler"] = "verlet"

    @model_validator(mode="after")
    def _ends(self) -> "Stepped":
        if self.restitution < MIN_RESTITUTION:
            rule = (
                f"must be at least {MIN_RESTITUTION:g} for 'stepped', not {self.restitution!r}: at 0 a "
                "contact has no end, so no step is a part of it; 'soft' and 'rigid' allow 0"
            )
            raise BrokenRuleError("restitution", rule)
        return self


class Rigid(Strict):
    """Ideal plate; restitution 0 sticks at once."""

    kind: Literal["rigid"]
    restitution: _Restitution = 0.0


class Ball(Strict):
    """One rigid point mass; restitution null takes the spring's own, f(xi)."""

    kind: Literal["ball"]
    restitution: Annotated[float, Field(ge=0.0, lt=1.0), NUMBER] | None = None


class Auto(_SoftContact):
    """The cheapest model within `tolerance` (rad of flight time) of exact soft."""

    kind: Literal["auto"]
    tolerance: Annotated[float, NUMBER] = 1e-3

    @model_validator(mode="after")
    def _attainable(self) -> "Auto":
        if self.tolerance < MIN_TOLERANCE:
            rule = (
                f"must be at least {MIN_TOLERANCE:g}, not {self.tolerance!r}: the exact solution's own "
                "rounding is of that size; ask for 'soft' where nothing else will do"
            )
            raise BrokenRuleError("tolerance", rule)
        return self

    @property
    def exact(self) -> Soft:
        """The contact that the tolerance is measured from."""
        return Soft(**self.model_dump(include=set(_SoftContact.model_fields) - {"kind"}))


MODELS: Final[dict[str, type[Strict]]] = {
    "soft": Soft, "stepped": Stepped, "rigid": Rigid, "ball": Ball, "auto": Auto,
}  # fmt: skip
MODEL_FIELDS: Final = {f"<{kind}>": tuple(model.model_fields) for kind, model in MODELS.items()}


def _kind_of(value: object) -> object:
    return value.get("kind", "soft") if isinstance(value, dict) else getattr(value, "kind", None)


def _check_kind(value: object) -> object:
    if not isinstance(value, dict | Strict):
        raise BrokenRuleError("", f'must be an object such as {{"kind": "soft"}}, not {describe(value)}')
    kind = _kind_of(value)
    if isinstance(kind, str) and kind in MODELS:
        return value
    rule = f"must be {one_of(MODELS)}, not {describe(kind)}{did_you_mean(kind, MODELS)}"
    raise BrokenRuleError("kind", rule)


ContactModel = Annotated[
    Annotated[Soft, Tag("<soft>")]
    | Annotated[Stepped, Tag("<stepped>")]
    | Annotated[Rigid, Tag("<rigid>")]
    | Annotated[Ball, Tag("<ball>")]
    | Annotated[Auto, Tag("<auto>")],
    Discriminator(lambda value: f"<{_kind_of(value)}>"),
    BeforeValidator(_check_kind),
]


AnyContact = Soft | Stepped | Rigid | Ball | Auto


def kernel_model(model: AnyContact) -> Model:
    """The kernel's name for a specification's model; where none has been chosen yet, the exact one's."""
    return Model.SOFT if isinstance(model, Auto) else Model[model.kind.upper()]


def penetration_of(
    model: AnyContact, gamma: NDArray[np.float64], omega: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Contact depth d = delta_c/A of each cell, in plate amplitudes.

    A rest length L = Lambda*g/omega0**2 has l = L/A = Lambda*Omega**2/Gamma, of which the
    paper takes 1e-4. Models without a soft contact ignore the number.
    """
    rest_length = getattr(model, "rest_length", None)
    if rest_length is not None:
        return np.asarray(1e-4 * rest_length * omega**2 / gamma, dtype=np.float64)
    depth = getattr(model, "penetration", None) or DEFAULT_PENETRATION
    return np.full(np.broadcast(gamma, omega).shape, depth, dtype=np.float64)


def restitution_of(model: AnyContact, xi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Restitution of an isolated impact in each cell; a ball that is given none has its spring's, f(xi)."""
    if model.restitution is None:
        return spring_restitution(xi)
    return np.full(np.shape(xi), model.restitution, dtype=np.float64)


class Steps(NamedTuple):
    """What the kernel is told of time steps; models that take none ignore it."""

    steps_per_contact: int = 20
    scheme: str = "verlet"


def steps_of(model: AnyContact) -> Steps:
    """The time steps of a specification's model."""
    return Steps(model.steps_per_contact, model.scheme) if isinstance(model, Stepped) else Steps()
