"""The figures of the paper, drawn from small grids, and what their captions claim."""

from collections import UserDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import matplotlib.image
from artists import read_back
from matplotlib.figure import Figure
from paths import GOLDEN

from service import presets
from service.client import Client
from service.figures import catalogue
from service.figures.drawing import Caption
from service.pictures import DPI, STYLE
from service.presets import FigurePreset

#: What makes each figure small enough for a test, its cells still the paper's.
SMALL: Mapping[int, Mapping[str, Any]] = {
    1: {},
    2: {"gamma": {"start": 1.0, "stop": 6.0, "num": 101}},
    3: {"gamma": {"start": 1.0, "stop": 7.0, "num": 61}},
    4: {"gamma": {"start": 1.0, "stop": 7.0, "num": 121}},
    5: {"omega": [0.4, 0.63, 1.0, 1.2, 2.0]},
    6: {},
    7: {"gamma": {"start": 0.05, "stop": 6.0, "num": 120}},
    8: {"omega": {"start": 0.05, "stop": 2.0, "num": 79}},
    9: {
        "omega": [0.42, 0.44, 0.46, 0.56, 0.6, 0.62, 0.66, 0.7],
        "gamma": {"start": 0.1, "stop": 1.6, "num": 376},
    },
}

#: What each figure draws from these cells.
DRAWN = GOLDEN / "figures.json"

NEAR_TWO = {"gamma": {**presets.GAMMA_NEAR_TWO, "num": 9}}


def small(figure: FigurePreset) -> FigurePreset:
    """The figure with fewer cells."""
    changed = SMALL[figure.number]
    return figure._replace(
        sweeps=tuple(
            {**sweep, **(NEAR_TWO if sweep["gamma"] == presets.GAMMA_NEAR_TWO else changed)}
            for sweep in figure.sweeps
        ),
    )


SMALL_FIGURES = {number: small(figure) for number, figure in catalogue.FIGURES.items()}


@dataclass(frozen=True)
class Made:
    """A picture, its caption, and its artists as text."""

    content: bytes
    caption: Caption
    drawn: list[str]


class Pictures(UserDict[int, Made]):
    """Figures by number, each made when it is first asked for."""

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._client = client

    def __missing__(self, number: int) -> Made:
        (drawing,) = catalogue.make([SMALL_FIGURES[number]], self._client, progress=False)
        with mpl.rc_context(STYLE):
            drawing.compose(figure := Figure(dpi=DPI, layout="constrained"))
            self[number] = Made(drawing.encoded("png"), drawing.caption, read_back(figure))
        return self[number]
