"""The figures of the paper by number. Each submits its preset sweeps and is drawn from the jobs.

Importing this module does not load matplotlib.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, Final

from service import presets
from service.client import BounceError, Client, Job
from service.presets import FigurePreset

if TYPE_CHECKING:
    from service.figures.drawing import Drawing

FIGURES: Final[Mapping[int, FigurePreset]] = {figure.number: figure for figure in presets.FIGURES}


def figures(selection: str) -> list[FigurePreset]:
    """The figure of this number, or "all". Raises BounceError naming those there are."""
    if selection == "all":
        return list(FIGURES.values())
    if not selection.isdecimal() or int(selection) not in FIGURES:
        raise BounceError(f"unknown figure {selection}; choose one of: {', '.join(map(str, FIGURES))}, all")
    return [FIGURES[int(selection)]]


def figure(number: int, client: Client) -> "Drawing":
    """Figure `number` of the paper, computed by a service. Raises as `figures` and `make`."""
    return next(make(figures(str(number)), client))


def make(selected: Sequence[FigurePreset], client: Client, *, progress: bool = True) -> Iterator["Drawing"]:
    """Make the figures in order. Raises the errors of `service.client`.

    Sweeps that are computed already come back as jobs in state done. Workers compute the sweeps of later
    figures while earlier ones are drawn.
    """
    import_module("matplotlib")  # a client alone lacks it: before anything is computed
    submitted = [[client.submit(sweep) for sweep in figure.sweeps] for figure in selected]
    if any(figure.number == 2 for figure in selected):
        Thread(target=_compile_motions, args=(client,), daemon=True).start()
    for figure, jobs in zip(selected, submitted, strict=True):
        yield _drawing(figure.number, client, [job.wait(progress=progress) for job in jobs])


def _compile_motions(client: Client) -> None:
    """Let the service compile kernels for Fig. 2's insets while workers compile those for its sweeps."""
    from service.figures.flights import motion

    with suppress(Exception):  # the figure asks again, and reports the error
        motion(client, max(presets.INSETS), settle=0)


def _drawing(number: int, client: Client, jobs: Sequence[Job]) -> "Drawing":
    from service.figures import flights, onsets, schematics

    draw: Mapping[int, Callable[..., Drawing]] = {
        1: schematics.figure_1, 2: partial(flights.figure_2, client), 3: flights.figure_3,
        4: flights.figure_4, 5: onsets.figure_5, 6: onsets.figure_6, 7: flights.figure_7,
        8: flights.figure_8, 9: partial(onsets.figure_9, client),
    }  # fmt: skip
    return draw[number](*jobs)
