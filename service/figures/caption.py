"""Captions: what a figure shows, what agrees with the text of the paper, and what differs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """A statement on a result, and whether the paper says the same."""

    holds: bool
    text: str


@dataclass(frozen=True)
class Caption:
    """The text under a figure; `shows` describes what is drawn and how it was computed."""

    number: int
    shows: str
    claims: tuple[Claim, ...]

    @property
    def agrees(self) -> str:
        """The claims that agree with the paper."""
        return self._joined(True)

    @property
    def differs(self) -> str:
        """The claims that differ from the paper, or that it leaves open."""
        return self._joined(False)

    @property
    def paragraphs(self) -> list[tuple[str, str]]:
        """Headings and texts; paragraphs without text are left out."""
        parts = [(f"Fig. {self.number}.", self.shows), ("Agrees:", self.agrees), ("Differs:", self.differs)]
        return [(heading, text) for heading, text in parts if text]

    def __str__(self) -> str:
        return "\n".join(f"{heading} {text}" for heading, text in self.paragraphs)

    def _joined(self, holds: bool) -> str:
        text = "; ".join(claim.text for claim in self.claims if bool(claim.holds) is holds)
        return f"{text}." if text else ""


def mode(bounces: int, periods: int) -> str:
    """A mode in the notation of the paper."""
    return f"({bounces}, {periods})"
