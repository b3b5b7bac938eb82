"""What is said beside a figure: what it shows, what agrees with the paper's text, and what does not."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """A sentence on what was found, and whether that is what the paper says."""

    holds: bool
    text: str


@dataclass(frozen=True)
class Caption:
    """`shows` says what is drawn and how it was computed."""

    number: int
    shows: str
    claims: tuple[Claim, ...]

    @property
    def agrees(self) -> str:
        """What is as the paper says."""
        return self._said(True)

    @property
    def differs(self) -> str:
        """What is not as the paper says, or left open by it."""
        return self._said(False)

    @property
    def paragraphs(self) -> list[tuple[str, str]]:
        """Heading and text, empty ones left out."""
        parts = [(f"Fig. {self.number}.", self.shows), ("Agrees:", self.agrees), ("Differs:", self.differs)]
        return [(heading, text) for heading, text in parts if text]

    def __str__(self) -> str:
        return "\n".join(f"{heading} {text}" for heading, text in self.paragraphs)

    def _said(self, holds: bool) -> str:
        text = "; ".join(claim.text for claim in self.claims if bool(claim.holds) is holds)
        return f"{text}." if text else ""


def mode(bounces: int, periods: int) -> str:
    """A mode as the paper writes it."""
    return f"({bounces}, {periods})"
