"""The figures of the paper by number.

Each submits its preset sweeps and is drawn from the jobs.

Importing this module does not load matplotlib.
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
    """The paper has no figure of this number, or the project does not draw it."""

    def __init__(self, number: str) -> None:
        known = ", ".join([*map(str, FIGURES), "all"])
        super().__init__(f"unknown figure {number}; choose one of: {known}")


@dataclass(frozen=True)
class Picture:
    """The bytes of a file, and the caption under the drawing in it."""

    content: bytes
    caption: Caption


@dataclass(frozen=True)
class Figure:
    """One figure and the sweeps it is drawn from."""

    number: int
    title: str
    sweeps: tuple[Sweep, ...]

    def submit(self, client: Client) -> list[Job]:
        """Submit the sweeps; sweeps that are already computed come back as jobs in state done."""
        return [client.submit(sweep) for sweep in self.sweeps]

    def make(self, client: Client, format: str = "png", *, progress: bool = True) -> Picture:
        """Compute what is missing and draw, as png, svg or pdf. Raises the errors of `service.client`."""
        jobs = [job.wait(progress=progress) for job in self.submit(client)]
        drawing = _draw_functions()[self.number](client, jobs)
        return Picture(drawing.encoded(format), drawing.caption)


FIGURES: Final[Mapping[int, Figure]] = {preset.number: Figure(*preset) for preset in presets.FIGURES}


def figures(selection: str) -> list[Figure]:
    """The figure of this number, or "all". Raises UnknownFigure with those there are."""
    if selection == "all":
        return list(FIGURES.values())
    if not selection.isdecimal() or int(selection) not in FIGURES:
        raise UnknownFigure(selection)
    return [FIGURES[int(selection)]]


def make(
    selected: Sequence[Figure], client: Client, format: str, *, progress: bool = True
) -> Iterator[Picture]:
    """Make the figures in order; workers compute the later ones while the earlier ones are drawn."""
    for figure in selected:
        figure.submit(client)
    for figure in selected:
        yield figure.make(client, format, progress=progress)


def _draw_functions() -> Mapping[int, Draw]:
    """How each figure is drawn from its jobs, by number."""
    from service.figures import ball, hysteresis, modes, schematics, sections, thresholds

    return {
        1: lambda client, jobs: schematics.draw(),
        2: lambda client, jobs: modes.draw(client, *jobs),
        3: lambda client, jobs: ball.draw_inelastic(*jobs),
        4: lambda client, jobs: ball.draw_elastic(*jobs),
        5: lambda client, jobs: thresholds.draw_dampings(*jobs),
        6: lambda client, jobs: thresholds.draw_sections(*jobs),
        7: lambda client, jobs: sections.draw_along_gamma(*jobs),
        8: lambda client, jobs: sections.draw_along_omega(*jobs),
        9: lambda client, jobs: hysteresis.draw(*jobs),
    }
