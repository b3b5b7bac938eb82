"""Protocols of a sweep: each cell starts from rest, or on a ramp from the previous cell's final state."""

from typing import Annotated, Any, Final, Literal

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
)

from worker.spec.axes import WHOLE, Strict
from worker.spec.errors import BrokenRuleError, describe, one_of

AxisName = Literal["gamma", "omega", "xi"]


class Rest(Strict):
    """Every cell starts from rest."""

    kind: Literal["rest"] = "rest"


#: Maximum plate periods of a cycle on which a ramp starts.
MAX_START_PERIODS: Final = 12


def _one_bounce(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool) and value != 1:
        rule = f"must be 1, not {describe(value)}: cycles of one flight have a closed form"
        raise BrokenRuleError("", rule)
    return value


class OnCycle(Strict):
    """The stable cycle in closed form on which the first cell of a line starts (docs/hysteresis.md)."""

    bounces: Annotated[int, WHOLE, BeforeValidator(_one_bounce)] = 1
    periods: Annotated[int, Field(ge=1, le=MAX_START_PERIODS), WHOLE] = 1


#: Tagged, so that errors name its fields and not those of the ramp.
Start = Annotated[
    Annotated[OnCycle, Tag("<start>")] | Annotated[None, Tag("<rest>")],
    Discriminator(lambda value: "<rest>" if value is None else "<start>"),
]


class Ramp(Strict):
    """One parameter moves along its axis, and each cell starts from the final state of the previous one.

    The first cell of a line starts from rest, or on a cycle.
    """

    kind: Literal["ramp"] = "ramp"
    axis: AxisName
    direction: Literal["up", "down", "both"]
    start: Start = None

    @model_serializer(mode="wrap")
    def _plain(self, default: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit a start that is off: job ids made before the field existed must not change."""
        plain: dict[str, Any] = default(self)
        return {name: value for name, value in plain.items() if name != "start" or value is not None}


#: The protocols of a sweep by kind.
PROTOCOLS: Final[dict[str, type[Strict]]] = {"rest": Rest, "ramp": Ramp}

#: Every kind of protocol; those of other studies have their own specifications (`worker.studies`).
KINDS: Final = (*PROTOCOLS, "orbits", "basin", "multistability")


def _kind_of(value: object) -> object:
    return value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)


def _check_protocol(value: object) -> object:
    if not isinstance(value, dict | Strict):
        raise BrokenRuleError("", f'must be an object such as {{"kind": "rest"}}, not {describe(value)}')
    if _kind_of(value) not in PROTOCOLS:
        rule = f"must be {one_of(KINDS)}, not {describe(_kind_of(value))}"
        raise BrokenRuleError("kind", rule if "kind" in _keys(value) else f"is required: {one_of(KINDS)}")
    return value


def _keys(value: object) -> list[str]:
    return list(value) if isinstance(value, dict) else ["kind"]


Protocol = Annotated[
    Annotated[Rest, Tag("<rest>")] | Annotated[Ramp, Tag("<ramp>")],
    Discriminator(lambda value: f"<{_kind_of(value)}>"),
    BeforeValidator(_check_protocol),
]
