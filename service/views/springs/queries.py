"""What queries of a spring have in common: its contact, the modes of its cycles, limits."""

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from pydantic import Field

from kernel.cycles.events import flight_times
from kernel.params import KernelInputError
from service.errors import InvalidRequest
from service.views.view import Number, Query
from worker.orbits.specification import MAX_GRID, check_modes, read_mode
from worker.spec.contact_models import MAX_PENETRATION, MIN_PENETRATION, ContactFields, Rigid, Soft
from worker.spec.errors import BrokenRuleError, SpecInvalid

Modes = Annotated[str, Field(max_length=200, description="bounces-periods, as 1-1,1-2; cycles of one bounce")]
#: Γ at which branches and curves are cut by default.
GAMMA_MAX: Final = 8.0
#: Limit on Γ of branches and curves.
MAX_GAMMA: Final = 1e6
#: The rule for it.
ONLY_ALONG_GAMMA: Final = "is of branches along gamma, and these are along {}"
Gamma = Annotated[Number, Field(gt=0, le=MAX_GAMMA)]

#: The contacts whose cycles are followed, and their parameters.
_CONTACTS: Final[Mapping[str, type[Rigid | Soft]]] = {"rigid": Rigid, "soft": Soft}
_OF_CONTACT: Final = ("restitution", "penetration", "adhesive")


class ContactQuery(Query):
    """The contact that the spring has."""

    model: Literal["rigid", "soft"] | None = Field(
        None, description="contact whose cycles are followed; default: the ideal plate in closed form"
    )
    restitution: Annotated[Number, Field(ge=0, lt=1)] | None = Field(None, description="of the model")
    penetration: Annotated[Number, Field(ge=MIN_PENETRATION, le=MAX_PENETRATION)] | None = Field(
        None, description="of a soft model, in plate amplitudes"
    )
    adhesive: Annotated[bool, Field(description="whether a soft model pulls before take-off")] = True

    def contact(self) -> Rigid | Soft | None:
        """The contact whose cycles are followed; None for the closed form. Raises InvalidRequest."""
        given = self.model_dump(include={"model", *_OF_CONTACT}, exclude_defaults=True)
        if "model" not in given:
            if given:
                raise InvalidRequest.of("model", f"is required with {', '.join(given)}: rigid or soft")
            return None
        fields = _CONTACTS[given.pop("model")]
        if others := given.keys() - fields.model_fields:
            raise InvalidRequest.of(min(others), f"is of soft, not of {self.model}")
        try:
            return fields(**given)
        except SpecInvalid as error:
            raise InvalidRequest("; ".join(map(str, error.problems)), error.problems) from error


def name_of(plate: ContactFields) -> str:
    """A contact and its parameters as text."""
    return ", ".join(_text(name, value) for name, value in plate.model_dump(exclude_none=True).items())


def _text(name: str, value: object) -> str:
    if isinstance(value, bool):
        return name if value else f"not {name}"
    return f"{name.replace('_', ' ')} {value:g}" if isinstance(value, int | float) else str(value)


def parse_modes(text: str) -> tuple[int, ...]:
    """The plate periods of modes of one bounce, written as `1-1,1-2`. Raises InvalidRequest."""
    try:
        return tuple(sorted(check_modes([read_mode(part.strip()) for part in text.split(",")])))
    except BrokenRuleError as error:
        raise InvalidRequest.of("modes", error.rule) from error


def grid_length(omega: float, xi: float, periods: int, points: int = 1, field: str = "omega") -> int:
    """Number of flight times of a branch. Raises InvalidRequest if it takes too many, or has none.

    field: the parameter of the query with this omega.
    """
    try:
        return len(flight_times(omega, xi, periods, points, most=MAX_GRID))
    except KernelInputError as error:
        raise InvalidRequest.of(field if error.argument == "omega" else error.argument, error.rule) from error
