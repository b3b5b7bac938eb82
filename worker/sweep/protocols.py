"""Protocols of a sweep: cells start from rest, or on a ramp from the final state of the cell before."""

from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from worker.spec.axes import WHOLE, Strict, check_kind, kind_of
from worker.spec.errors import BrokenRuleError, describe


class Rest(Strict):
    """Every cell starts from rest."""

    kind: Literal["rest"] = "rest"


#: Limit on the plate periods of a cycle on which a ramp starts.
MAX_START_PERIODS: Final = 12


def _one_bounce(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool) and value != 1:
        rule = f"must be 1, not {describe(value)}: cycles of one flight have a closed form"
        raise BrokenRuleError("", rule)
    return value


class OnCycle(Strict):
    """The stable cycle in closed form on which the first cell of a line starts (docs/hysteresis.md)."""

    bounces: Annotated[int, WHOLE, BeforeValidator(_one_bounce)] = 1
    periods: Annotated[
        int,
        Field(
            ge=1,
            le=MAX_START_PERIODS,
            title="first cell on the stable cycle (1, k): k",
            description="Plate periods; left out: from rest.",
        ),
        WHOLE,
    ] = 1


#: Tagged, so that errors name the cycle's fields and not the ramp's.
Start = Annotated[
    Annotated[OnCycle, Tag(OnCycle.tag())] | Annotated[None, Tag("<null>")],
    Discriminator(lambda value: "<null>" if value is None else OnCycle.tag()),
]


class Ramp(Strict):
    """One parameter moves along its axis, and each cell starts from the final state of the previous one.

    The first cell of a line starts from rest, or on a cycle.
    """

    kind: Literal["ramp"] = "ramp"
    axis: Literal["gamma", "omega", "xi"]
    direction: Literal["up", "down", "both"]
    #: Excluded from rest: ids of jobs made before the field existed must not change.
    start: Annotated[Start, Field(exclude_if=lambda start: start is None)] = None


#: The protocols of a sweep by kind.
PROTOCOLS: Final[dict[str, type[Strict]]] = {"rest": Rest, "ramp": Ramp}

#: Every kind of protocol; those of other studies have their own specifications (`worker.studies`).
KINDS: Final = (*PROTOCOLS, "orbits", "basin", "multistability")


Protocol = Annotated[
    Annotated[Rest, Tag(Rest.tag())] | Annotated[Ramp, Tag(Ramp.tag())],
    Discriminator(lambda value: PROTOCOLS[kind_of(value)].tag()),
    BeforeValidator(lambda value: check_kind(value, PROTOCOLS, KINDS)),
]
