"""The paper's figures by number: the sweeps each one needs, and how it is drawn from them.

Importing this loads nothing that draws.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from service import presets
from service.client import BounceError, Client, Job
from service.figures.caption import Caption
from service.presets import Sweep

if TYPE_CHECKING:
    from service.figures.canvas import Drawing

Draw: TypeAlias = Callable[[Client, Sequence[Job]], "Drawing"]


class UnknownFigure(BounceError):
    """There is no such figure here."""

    def __init__(self, number: str) -> None:
        super().__init__(f"there is no figure {number} here; there are: {', '.join(map(str, FIGURES))}, all")


@dataclass(frozen=True)
class Picture:
    """A file's bytes, and what stands under the picture in it."""

    content: bytes
    caption: Caption


@dataclass(frozen=True)
class Figure:
    """One figure of the paper: `draw` takes a client and the figure's jobs, all done."""

    number: int
    title: str
    sweeps: tuple[Sweep, ...]
    draw: Draw

    def submit(self, client: Client) -> list[Job]:
        """Hand in the sweeps; those that are done come back done."""
        return [client.submit(sweep) for sweep in self.sweeps]

    def make(self, client: Client, format: str = "png", *, progress: bool = True) -> Picture:
        """Compute what is not computed yet and draw, as png or svg. Raises whatever the client raises."""
        jobs = [job.wait(progress=progress) for job in self.submit(client)]
        drawing = self.draw(client, jobs)
        return Picture(drawing.encoded(format), drawing.caption)


def figures(which: str) -> list[Figure]:
    """The figure with this number, or all. Raises UnknownFigure naming those there are."""
    if which == "all":
        return list(FIGURES.values())
    if not which.isdecimal() or int(which) not in FIGURES:
        raise UnknownFigure(which)
    return [FIGURES[int(which)]]


def make(
    wanted: Sequence[Figure], client: Client, format: str, *, progress: bool = True
) -> Iterator[Picture]:
    """The figures one by one; workers compute the later ones while the earlier ones are drawn."""
    for one in wanted:
        one.submit(client)
    for one in wanted:
        yield one.make(client, format, progress=progress)


def _models(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import schematics

    return schematics.draw()


def _modes(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import modes

    return modes.draw(client, *jobs)


def _rigid(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import ball

    return ball.draw_inelastic(*jobs)


def _elastic(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import ball

    return ball.draw_elastic(*jobs)


def _onsets(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import thresholds

    return thresholds.draw_dampings(*jobs)


def _sections(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import thresholds

    return thresholds.draw_sections(*jobs)


def _along_gamma(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import sections

    return sections.draw_along_gamma(*jobs)


def _along_omega(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import sections

    return sections.draw_along_omega(*jobs)


def _hysteresis(client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import hysteresis

    return hysteresis.draw(*jobs)


FIGURES: Final[Mapping[int, Figure]] = {
    one.number: one
    for one in (
        Figure(1, "the two models", (), _models),
        Figure(2, "bifurcation diagram and motion at Ω = 0.5, ξ = 0.26", presets.figure_2(), _modes),
        Figure(3, "rigid spring and inelastic ball", presets.figure_3(), _rigid),
        Figure(4, "rigid spring of low viscosity and partially elastic ball", presets.figure_4(), _elastic),
        Figure(5, "bouncing threshold at four dampings", presets.figure_5(), _onsets),
        Figure(6, "threshold at ξ = 0.05 and the sections of Figs. 7 and 8", presets.figure_6(), _sections),
        Figure(7, "flight times against Γ at three Ω", presets.figure_7(), _along_gamma),
        Figure(8, "flight times against Ω at three Γ", presets.figure_8(), _along_omega),
        Figure(9, "thresholds up and down", presets.figure_9(), _hysteresis),
    )
}
