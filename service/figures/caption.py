"""Captions: what a figure shows, and how what it shows compares with the text of the paper."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How a result compares with the paper; the value is the label in a caption."""

    AGREES = "Agrees"  # the paper says the same
    CONTRADICTS = "Contradicts"  # the paper says otherwise
    LEFT_OPEN = "Left open by the paper"  # it does not say, and the result depends on it or adds to it


@dataclass(frozen=True)
class Claim:
    """A statement on a result."""

    verdict: Verdict
    text: str


def compared(holds: bool, text: str) -> Claim:
    """A claim on what the paper states; `holds`: whether the result is the same."""
    return Claim(Verdict.AGREES if holds else Verdict.CONTRADICTS, text)


def left_open(text: str) -> Claim:
    """A claim on what the paper does not state."""
    return Claim(Verdict.LEFT_OPEN, text)


@dataclass(frozen=True)
class Caption:
    """The text under a figure; `shows` describes what is drawn and how it was computed."""

    number: int
    shows: str
    claims: tuple[Claim, ...]

    def claims_that(self, verdict: Verdict) -> str:
        """The claims of one verdict, joined; empty if there are none."""
        text = "; ".join(claim.text for claim in self.claims if claim.verdict is verdict)
        return f"{text}." if text else ""

    @property
    def paragraphs(self) -> list[tuple[str, str]]:
        """Headings and texts; paragraphs without text are left out."""
        verdicts = [(f"{verdict}:", self.claims_that(verdict)) for verdict in Verdict]
        return [
            (heading, text) for heading, text in ((f"Fig. {self.number}.", self.shows), *verdicts) if text
        ]

    def __str__(self) -> str:
        return "\n".join(f"{heading} {text}" for heading, text in self.paragraphs)


def mode(bounces: int, periods: int) -> str:
    """A mode in the notation of the paper."""
    return f"({bounces}, {periods})"


def percent(share: float, digits: int = 0) -> str:
    """A share as a quantity with its unit: `86 %`."""
    return f"{100 * share:.{digits}f} %"
