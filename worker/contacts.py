"""Room: how a specification names its contact model, and what that means cell by cell.

Imports pydantic, numpy, kernel.params and its neighbours in worker; never numba.
"""

from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from kernel.params import Model
from worker.axes import NUMBER, WHOLE, Strict
from worker.problems import BrokenRuleError, describe, did_you_mean, one_of

#: The kinds that can be computed today. Building another one is finished by naming it here.
AVAILABLE_MODELS: Final = ("soft", "rigid")

#: Contact depths delta_c/A between these are what double precision carries.
MIN_PENETRATION: Final = 1e-12
MAX_PENETRATION: Final = 1.0
DEFAULT_PENETRATION: Final = 1e-3

#: A law that never pulls reaches e = 0 only as its damping grows without bound.
MIN_NONADHESIVE_RESTITUTION: Final = 1e-6

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
        if not self.adhesive and self.restitution < MIN_NONADHESIVE_RESTITUTION:
            rule = (
                f"must be at least {MIN_NONADHESIVE_RESTITUTION:g} where adhesive is false, "
                f"not {self.restitution!r}: without pull, less needs damping without bound"
            )
            raise BrokenRuleError("restitution", rule)
        return self


class Soft(_SoftContact):
    """Spring-dashpot contact, solved exactly."""

    kind: Literal["soft"] = "soft"


class Stepped(_SoftContact):
    """The same contact by fixed time steps."""

    kind: Literal["stepped"]
    steps_per_contact: Annotated[int, Field(ge=1, le=10_000), WHOLE] = 20


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
    tolerance: Annotated[float, Field(gt=0.0), NUMBER] = 1e-3


_KINDS: Final[dict[str, type[Strict]]] = {
    "soft": Soft, "stepped": Stepped, "rigid": Rigid, "ball": Ball, "auto": Auto,
}  # fmt: skip
MODEL_FIELDS: Final = {f"<{kind}>": tuple(model.model_fields) for kind, model in _KINDS.items()}


def _kind_of(value: object) -> object:
    return value.get("kind", "soft") if isinstance(value, dict) else getattr(value, "kind", None)


def _check_kind(value: object) -> object:
    if not isinstance(value, dict | Strict):
        raise BrokenRuleError("", f'must be an object such as {{"kind": "soft"}}, not {describe(value)}')
    kind = _kind_of(value)
    if kind in AVAILABLE_MODELS:
        return value
    if isinstance(kind, str) and kind in _KINDS:
        raise BrokenRuleError("kind", f"'{kind}' is not built yet; use {one_of(AVAILABLE_MODELS)}")
    hint = did_you_mean(kind, AVAILABLE_MODELS)
    raise BrokenRuleError("kind", f"must be {one_of(AVAILABLE_MODELS)}, not {describe(kind)}{hint}")


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
    """The kernel's name for a specification's model."""
    return Model[model.kind.upper()]


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
    """Restitution of an isolated impact in each cell."""
    return np.full(np.shape(xi), model.restitution, dtype=np.float64)
