"""The paper's figures: which sweeps each one needs and how it is drawn from them.

The paper's own contact is soft (Eqs. 9-12), its restitution set "as closest as possible to zero". Eq. 12
holds for the adhesive law, under which the exact solution reaches zero itself: no small hops after a landing,
which time steps cannot avoid. The contact's depth follows from a rest length that the paper does not state;
1e-3 plate amplitudes is taken, which makes the flights of Fig. 2's modes 2e-3 rad shorter than a rigid plate.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from service.client import BounceError, Client, Job

SOFT: Final[Mapping[str, Any]] = {"kind": "soft", "restitution": 0.0, "penetration": 1e-3, "adhesive": True}

Draw: TypeAlias = Callable[[Sequence[Job], str], bytes]


class UnknownFigure(BounceError):
    """There is no such figure here."""

    def __init__(self, number: int) -> None:
        super().__init__(f"there is no figure {number} here; there are: {', '.join(map(str, FIGURES))}")


@dataclass(frozen=True)
class Figure:
    """One figure of the paper: `draw` takes its jobs, all done, and a format (png, svg)."""

    number: int
    title: str
    sweeps: tuple[Mapping[str, Any], ...]
    draw: Draw

    def make(self, client: Client, format: str = "png", *, progress: bool = True) -> bytes:
        """Compute what is not computed yet and draw. Raises whatever the client raises."""
        jobs = [client.submit(sweep) for sweep in self.sweeps]
        return self.draw([job.wait(progress=progress) for job in jobs], format)


def figure(number: int) -> Figure:
    """The figure with this number. Raises UnknownFigure naming those there are."""
    try:
        return FIGURES[number]
    except KeyError:
        raise UnknownFigure(number) from None


def _fig2(jobs: Sequence[Job], format: str) -> bytes:
    (job,) = jobs
    return job.picture("gamma", format=format)


FIGURES: Final[Mapping[int, Figure]] = {
    2: Figure(
        number=2,
        title="Fig. 2: bifurcation diagram at Ω = 0.5, ξ = 0.26",
        sweeps=(
            {
                "name": "figure 2",
                "gamma": {"start": 1.0, "stop": 6.0, "num": 1001},
                "omega": 0.5,
                "xi": 0.26,
                "protocol": {"kind": "rest"},
                "model": SOFT,
            },
        ),
        draw=_fig2,
    ),
}
