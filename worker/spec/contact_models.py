"""The contact models: the fields of each in a specification, their kernel arguments and their costs.

Imports no numba: the table names a model's kernel module, and the tasks that compute with it import it.
"""

import functools
import operator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, Field, GetCoreSchemaHandler, Tag, model_validator

from kernel.params import (
    BALL_DIMENSION,
    BUDGET,
    INELASTIC_DIMENSION,
    LANES,
    SPRING_DIMENSION,
    USUAL_EVALUATIONS,
)
from kernel.restitution import restitution_of as spring_restitution
from kernel.step_limits import Scheme, steps_per_period
from worker.spec.axes import NUMBER, WHOLE, Strict, check_kind, kind_of
from worker.spec.errors import BrokenRuleError

#: Range of contact depths d = delta_c/A that double precision can represent.
MIN_PENETRATION: Final = 1e-12
MAX_PENETRATION: Final = 1.0
MAX_REST_LENGTH: Final = 1e12
DEFAULT_PENETRATION: Final = 1e-3

#: Lower bound on the restitution of a nonadhesive contact, whose damping grows without bound as e goes to 0,
#: and of `stepped`, whose time step is a part of a contact's duration: with e = 0 an adhesive one never ends.
MIN_RESTITUTION: Final = 1e-6

#: Rounding error of the exact solution's flight times, rad.
MIN_TOLERANCE: Final = 1e-9

MAX_STEPS_PER_CONTACT: Final = 1_000_000

#: Core-microseconds per cell per plate period of `rigid`: of a cell alone; with restitution above 0, in lanes
#: and alone.
RIGID_ALONE_US: Final = 0.88
RIGID_ELASTIC_US: Final = 0.53
RIGID_ELASTIC_ALONE_US: Final = 1.5
#: The same of `soft`: for each decade of penetration below the default, as more hops follow an impact on a
#: stiffer contact; of a cell alone; the additional share from restitution SOFT_ELASTIC on.
SOFT_DECADE_US: Final = 0.1
SOFT_ALONE_US: Final = 2.35
SOFT_ELASTIC: Final = 0.3
SOFT_ELASTIC_SHARE: Final = 1.2
#: Cost of a spring's plate period at these Omega relative to the mean: a slow plate has more contacts and
#: flights a period, a fast one fewer.
PERIOD_OMEGA: Final = (0.02, 0.06, 0.2, 0.55, 1.7)
PERIOD_SHARE: Final = (1.8, 1.4, 1.15, 1.0, 0.4)
#: Cost of a ball's plate period at these restitutions relative to the mean: from 0.5 on most cells are
#: aperiodic.
BALL_RESTITUTION: Final = (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.99)
BALL_SHARE: Final = (0.36, 0.73, 1.06, 1.64, 2.55, 3.0, 2.2, 2.1, 1.6)

#: Evaluations per plate period of the busiest cells: HOPS/(1 - e) if chatter follows every landing, and
#: RINGS/Omega, at most 1/xi, if the spring rings from landing to landing.
HOPS: Final = 7.0
RINGS: Final = 4.0

_Array = NDArray[np.float64]
_OfImpact = Field(title="restitution e", description="Of an isolated impact, 0 to 1.")
_Restitution = Annotated[float, Field(ge=0.0, le=1.0), _OfImpact, NUMBER]


class ContactFields(Strict):
    """Contact fields of a specification; `kind` names the row of CONTACT_MODELS."""

    #: Whether the kernel computes cells, or lines of a ramp, side by side.
    in_lanes: ClassVar[bool] = False
    #: Dimension of the state in contact and flight; 0 where no variations are computed.
    dimension: ClassVar[int] = 0

    kind: str

    def plate_arguments(self, gamma: _Array, omega: _Array, xi: _Array) -> dict[str, Any]:
        """Keyword arguments of the kernel module's `plate` for cells (n,)."""
        raise NotImplementedError

    def cost_us(self, base: float, gamma: _Array, omega: _Array, xi: _Array, *, at_once: int) -> float:
        """Core-microseconds per cell per plate period of a sweep with these axis values.

        base: `ContactModel.cost_us`. at_once: cells, or lines of a ramp, computed side by side.
        """
        return base

    def busiest(self, gamma: _Array, omega: _Array, xi: _Array) -> float:
        """The cost of the busiest cells, which hop and ring most often, in multiples of `cost_us`."""
        ends = self.plate_arguments(gamma[[0, -1]], omega[[0, -1]], xi[[0, -1]])
        with np.errstate(divide="ignore"):
            hops = np.mean(HOPS / (1.0 - ends.get("restitution", 0.0)))
            lowest = 1.0 / np.min(ends.get("penetration", 0.0))  # a mass with lower hops stays in contact
            rings = min(np.mean(RINGS / omega), np.mean(1.0 / xi))
        evaluations = min(hops, HOPS + lowest) + rings
        return float(np.clip(evaluations, USUAL_EVALUATIONS, BUDGET) / USUAL_EVALUATIONS)

    @property
    def exponents(self) -> int:
        """Maximum Lyapunov exponents that can be computed with this contact; 0: none."""
        return self.dimension

    @property
    def certifies(self) -> bool:
        """Whether cycles can be certified, which needs variations."""
        return self.exponents > 0

    @property
    def has_own_cycles(self) -> bool:
        """Whether its cycles are followed by their segments, and are not those of an ideal plate."""
        return False

    @property
    def exact(self) -> Any:
        """The same contact, solved exactly."""
        return self


def _side_by_side(in_lanes: float, alone: float, at_once: int) -> float:
    """The cost of a cell with `at_once` computed side by side, from the costs in full lanes and alone.

    Half of the lanes, one vector, cost the same however full they are.
    """
    return min(alone, in_lanes * max(LANES // 2 / at_once, 1.0)) if at_once > 1 else alone


def _period_share(omega: _Array) -> float:
    """The cost of a spring's plate period at these Omega (n,) relative to the mean."""
    return float(np.mean(np.interp(omega, PERIOD_OMEGA, PERIOD_SHARE)))


class _SoftContact(ContactFields):
    """Fields of every model with a spring-dashpot contact."""

    restitution: _Restitution = 0.01
    penetration: Annotated[
        Annotated[float, Field(ge=MIN_PENETRATION, le=MAX_PENETRATION), NUMBER] | None,
        Field(title="contact depth d", description=f"In plate amplitudes; left out: {DEFAULT_PENETRATION}."),
    ] = None
    rest_length: Annotated[
        Annotated[float, Field(gt=0.0, le=MAX_REST_LENGTH), NUMBER] | None,
        Field(title="rest length Λ", description="Lω₀²/g, which sets the depth instead."),
    ] = None
    adhesive: Annotated[bool, Field(description="Whether the contact may pull.")] = True

    @model_validator(mode="before")
    @classmethod
    def _default_penetration(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("penetration") is None and data.get("rest_length") is None:
            return {**data, "penetration": DEFAULT_PENETRATION}
        return data

    def plate_arguments(self, gamma: _Array, omega: _Array, xi: _Array) -> dict[str, Any]:
        return {
            "restitution": np.full(np.shape(xi), self.restitution),
            "penetration": penetration_of(self, gamma, omega),
            "adhesive": self.adhesive,
        }

    @model_validator(mode="after")
    def _rules(self) -> "_SoftContact":
        if self.penetration is not None and self.rest_length is not None:
            rule = "must be left out where penetration is given: each alone sets the contact's depth"
            raise BrokenRuleError("rest_length", rule)
        if not self.adhesive and self.restitution < MIN_RESTITUTION:
            rule = (
                f"must be at least {MIN_RESTITUTION:g} where adhesive is false, "
                f"not {self.restitution!r}: without pull, less needs damping without bound"
            )
            raise BrokenRuleError("restitution", rule)
        return self

    @property
    def has_own_cycles(self) -> bool:
        """With a rest length every cell has its own depth."""
        return self.rest_length is None and self.restitution < 1.0

    @property
    def exact(self) -> "Soft":
        """The contact that the tolerance of `auto` refers to and the steps of `stepped` approximate."""
        return Soft(**self.model_dump(include=set(_SoftContact.model_fields) - {"kind"}))


class Soft(_SoftContact):
    """Spring-dashpot contact, solved exactly."""

    in_lanes: ClassVar = True
    dimension: ClassVar = SPRING_DIMENSION

    kind: Literal["soft"] = "soft"

    def cost_us(self, base: float, gamma: _Array, omega: _Array, xi: _Array, *, at_once: int) -> float:
        """`base` holds for full lanes and the default penetration."""
        depths = penetration_of(self, gamma[[0, -1]], omega[[0, -1]])
        decades = float(np.mean(np.log10(DEFAULT_PENETRATION / depths)))
        elastic = 1.0 + SOFT_ELASTIC_SHARE * min(self.restitution / SOFT_ELASTIC, 1.0)
        cost = _side_by_side(base + SOFT_DECADE_US * max(decades, 0.0), SOFT_ALONE_US, at_once)
        return cost * elastic * _period_share(omega)


class Stepped(_SoftContact):
    """The same contact with fixed time steps; `worker.spec.time_steps` checks them."""

    kind: Literal["stepped"] = "stepped"
    steps_per_contact: Annotated[
        int, Field(ge=1, le=MAX_STEPS_PER_CONTACT, description="Time steps of a contact."), WHOLE
    ] = 20
    scheme: Scheme = "verlet"
    events: Annotated[
        Literal["located", "plain"],
        Field(
            description="Take-off and landing: located in a shortened step, or at the end of a plain one.",
            exclude_if=lambda events: events == "located",  # ids of jobs before the field existed stay
        ),
    ] = "located"

    def plate_arguments(self, gamma: _Array, omega: _Array, xi: _Array) -> dict[str, Any]:
        names = ("steps_per_contact", "scheme", "events")
        return super().plate_arguments(gamma, omega, xi) | {name: getattr(self, name) for name in names}

    def cost_us(self, base: float, gamma: _Array, omega: _Array, xi: _Array, *, at_once: int) -> float:
        """`base` times the steps per plate period: the geometric mean of the sweep's two ends."""
        depths = penetration_of(self, gamma[[0, -1]], omega[[0, -1]])
        steps = steps_per_period(self.restitution, depths, self.steps_per_contact, adhesive=self.adhesive)
        return base * float(np.sqrt(np.prod(steps.astype(float))))

    def busiest(self, gamma: _Array, omega: _Array, xi: _Array) -> float:
        """1: steps take the same time in every cell."""
        return 1.0

    @model_validator(mode="after")
    def _ends(self) -> "Stepped":
        if self.restitution < MIN_RESTITUTION:
            rule = (
                f"must be at least {MIN_RESTITUTION:g} for 'stepped', not {self.restitution!r}: at 0 a "
                "contact has no end, so no step is a part of it; 'soft' and 'rigid' allow 0"
            )
            raise BrokenRuleError("restitution", rule)
        return self


class Rigid(ContactFields):
    """Ideal plate; restitution 0 sticks at once."""

    in_lanes: ClassVar = True

    kind: Literal["rigid"] = "rigid"
    restitution: _Restitution = 0.0

    def plate_arguments(self, gamma: _Array, omega: _Array, xi: _Array) -> dict[str, Any]:
        return {"restitution": np.full(np.shape(xi), self.restitution)}

    def cost_us(self, base: float, gamma: _Array, omega: _Array, xi: _Array, *, at_once: int) -> float:
        """`base` holds for full lanes."""
        alone = RIGID_ALONE_US
        if self.restitution > 0.0:
            base, alone = RIGID_ELASTIC_US, RIGID_ELASTIC_ALONE_US
        return _side_by_side(base, alone, at_once) * _period_share(omega)

    @property
    def exponents(self) -> int:
        return SPRING_DIMENSION if self.restitution > 0.0 else INELASTIC_DIMENSION

    @property
    def has_own_cycles(self) -> bool:
        """Without restitution they are those of an ideal plate."""
        return 0.0 < self.restitution < 1.0


class Ball(ContactFields):
    """One rigid point mass; restitution null takes the spring's own, f(xi)."""

    dimension: ClassVar = BALL_DIMENSION

    kind: Literal["ball"] = "ball"
    restitution: Annotated[
        Annotated[float, Field(ge=0.0, lt=1.0), NUMBER] | None,
        Field(title="restitution e", description="Of an isolated impact; left out: by the damping ratio."),
    ] = None

    def plate_arguments(self, gamma: _Array, omega: _Array, xi: _Array) -> dict[str, Any]:
        e = spring_restitution(xi) if self.restitution is None else np.full(np.shape(xi), self.restitution)
        return {"restitution": e}

    def cost_us(self, base: float, gamma: _Array, omega: _Array, xi: _Array, *, at_once: int) -> float:
        e = self.plate_arguments(gamma, omega, xi)["restitution"]
        return base * float(np.mean(np.interp(e, BALL_RESTITUTION, BALL_SHARE)))


class Auto(_SoftContact):
    """The cheapest model within `tolerance` (rad of flight time) of exact soft."""

    in_lanes: ClassVar = True

    kind: Literal["auto"] = "auto"
    tolerance: Annotated[float, Field(description="In rad of flight time."), NUMBER] = 1e-3

    @model_validator(mode="after")
    def _attainable(self) -> "Auto":
        if self.tolerance < MIN_TOLERANCE:
            rule = (
                f"must be at least {MIN_TOLERANCE:g}, not {self.tolerance!r}: the exact solution's own "
                "rounding is of that size; ask for 'soft' where nothing else will do"
            )
            raise BrokenRuleError("tolerance", rule)
        return self

    def cost_us(self, base: float, gamma: _Array, omega: _Array, xi: _Array, *, at_once: int) -> float:
        """The cost of the exact model, until a model is chosen."""
        return self.exact.cost_us(base, gamma, omega, xi, at_once=at_once)

    @property
    def certifies(self) -> bool:
        """True, as for every model that may be chosen."""
        return True


class ContactModel(NamedTuple):
    """One contact model: a row of CONTACT_MODELS."""

    fields: type[ContactFields]
    kernel: str  # name of the module that has its `plate`
    cost_us: float  # core-microseconds per cell per plate period from rest; of `stepped`, per time step
    label: str  # for figures and messages
    certified: float = 1.0  # share of the cost where cells end once they are certified
    ramp: float = 1.0  # cost of a ramp's cell relative to one from rest; of models in lanes, in full lanes


#: Every contact model by its kind. A new one needs a kernel module, its fields, and a row here (see
#: docs/architecture.md). The costs fit twenty measured studies (`python -m benchmarks.estimates`). On a ramp
#: fewer cells of springs are at rest.
CONTACT_MODELS: Final[dict[str, ContactModel]] = {
    "soft": ContactModel(Soft, "kernel.models.soft", 0.67, "soft contact", 0.53, 1.4),
    "stepped": ContactModel(Stepped, "kernel.models.stepped", 0.0049, "stepped contact"),
    "rigid": ContactModel(Rigid, "kernel.models.rigid", 0.25, "rigid contact", 0.77, 1.4),
    "ball": ContactModel(Ball, "kernel.models.ball", 0.17, "ball contact", 0.95),
    # until a model is chosen: the exact one, which is the most expensive
    "auto": ContactModel(Auto, "kernel.models.soft", 0.67, "auto contact", 0.53, 1.4),
}


class _Contact:
    """Union of the table's contacts, read when pydantic builds the schema of a specification."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        tagged = [Annotated[model.fields, Tag(model.fields.tag())] for model in CONTACT_MODELS.values()]
        discriminator = Discriminator(lambda value: CONTACT_MODELS[kind_of(value, "soft")].fields.tag())
        check = BeforeValidator(lambda value: check_kind(value, CONTACT_MODELS, CONTACT_MODELS, "soft"))
        return handler.generate_schema(
            Annotated[functools.reduce(operator.or_, tagged), discriminator, check]
        )


#: The contact of a specification: any row of the table.
Contact = Soft | Stepped | Rigid | Ball | Auto
if not TYPE_CHECKING:
    Contact = _Contact


def penetration_of(model: ContactFields, gamma: _Array, omega: _Array) -> _Array:
    """Contact depth d = delta_c/A in plate amplitudes, for cells (n,).

    A rest length L = Lambda*g/omega0**2 gives l = L/A = Lambda*Omega**2/Gamma and d = 1e-4*l, as in the
    paper. Models without a soft contact get DEFAULT_PENETRATION.
    """
    rest_length = getattr(model, "rest_length", None)
    if rest_length is not None:
        return np.asarray(1e-4 * rest_length * omega**2 / gamma, dtype=np.float64)
    depth = getattr(model, "penetration", None) or DEFAULT_PENETRATION
    return np.full(np.broadcast(gamma, omega).shape, depth, dtype=np.float64)
