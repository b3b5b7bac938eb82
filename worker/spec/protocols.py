"""Protocols of a sweep: each cell starts from rest, or on a ramp from the previous cell's final state."""

from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Discriminator, Tag

from worker.spec.axes import Strict
from worker.spec.errors import BrokenRuleError, describe, one_of

AxisName = Literal["gamma", "omega", "xi"]


class Rest(Strict):
    """Every cell starts from rest."""

    kind: Literal["rest"] = "rest"


class Ramp(Strict):
    """One parameter moves along its axis, and each cell starts from the final state of the previous one."""

    kind: Literal["ramp"]
    axis: AxisName
    direction: Literal["up", "down", "both"]


#: The protocols of a sweep by kind.
PROTOCOLS: Final[dict[str, type[Strict]]] = {"rest": Rest, "ramp": Ramp}

#: Every kind of protocol: those of other studies have specifications of their own (`worker.studies`).
KINDS: Final = (*PROTOCOLS, "orbits")


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
