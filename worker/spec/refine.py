"""Adaptive maps: the field `refine` of a sweep from rest over gamma and omega."""

from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from worker.spec.axes import WHOLE, Strict
from worker.spec.errors import BrokenRuleError

#: Widest first block of a map, in cells: wider ones miss more and save hardly any cells.
MAX_COARSEST: Final = 128

#: Longest cycles, in plate periods, that a map by mode distinguishes. Longer ones are one class: otherwise
#: every cell would be computed where they mix.
MAX_MODE_PERIODS: Final = 4

#: Default `coarsest`. Modes have islands and tongues of a few cells, which blocks of 64 miss; the bouncing
#: region has none (`python -m benchmarks.adaptive`).
COARSEST: Final = {"mode": 16, "bouncing": 64}


def _no_margin(value: object) -> object:
    if value is True:
        rule = "must be false: maps have no margin any more; a coarsest of 8 leaves about as few cells wrong"
        raise BrokenRuleError("", rule)
    return value


class Refine(Strict):
    """Compute only the cells near changes of the map; the others take their values from their block.

    `margin` is always false: part of the identity of maps since there was one.
    """

    by: Annotated[
        Literal["mode", "bouncing"],
        Field(title="compute", description="Other cells take the mode of their block."),
    ]
    coarsest: Annotated[int, Field(ge=2, le=MAX_COARSEST), WHOLE] = Field(
        default_factory=lambda fields: COARSEST[fields.get("by", "mode")],
        description="Cells across the first blocks; left out: 16 or 64.",
    )
    margin: Annotated[bool, BeforeValidator(_no_margin)] = False


class EarlierRefine(Refine):
    """A map of a release in which maps had a margin."""

    margin: bool = False

    def today(self) -> Refine:
        """What the refusal of a margin advises."""
        return Refine(by=self.by, coarsest=min(self.coarsest, 8) if self.margin else self.coarsest)


#: Tagged, so that errors name its fields and not those of the specification.
Refinement = Annotated[
    Annotated[Refine, Tag(Refine.tag())] | Annotated[None, Tag("<null>")],
    Discriminator(lambda value: "<null>" if value is None else Refine.tag()),
]
