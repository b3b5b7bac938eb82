"""Fig. 1: the bouncing ball and the bouncing spring, drawn."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.patches import Circle, Rectangle

from service.figures.drawing import Caption, Drawing, compared, left_open
from service.pictures import LINES

CAPTION = Caption(
    1,
    "The two models: a ball (left), and two masses joined by a spring and a damper (right), on a plate that "
    "oscillates as A cos ωt.",
    (
        compared(True, "the parts are those of Eqs. 1 to 8"),
        compared(False, "Eq. 4 lacks a sign: the ball leaves with v⁺ = −ε v⁻"),
        left_open(
            "whether the contact of the spring may pull, and how deep it is: 10⁻⁴ L, where L is not stated "
            "and drops out of the motion otherwise"
        ),
    ),
)

PLATE = 0.0
RADIUS = 0.34

#: The arrows of the plate and of gravity.
BOTH_WAYS = {"arrowstyle": "<->", "linewidth": 0.8}
ONE_WAY = {"arrowstyle": "-|>", "linewidth": 0.9, "color": "black"}


def figure_1() -> Drawing:
    """The two schematics, side by side on plates of one height."""
    return Drawing(CAPTION, 3.6, _draw)


def _draw(area: SubFigure) -> None:
    for axes, model in zip(area.subplots(1, 2, sharey=True), (_ball, _spring), strict=True):
        axes.set(aspect="equal", xlim=(-2.2, 2.2), ylim=(-1.25, 4.05))
        axes.axis("off")
        axes.add_patch(Rectangle((-1.7, PLATE - 0.16), 3.4, 0.16, facecolor="black"))
        axes.annotate("", (-1.35, -1.0), (-1.35, -0.22), arrowprops=BOTH_WAYS)
        axes.text(-1.15, -0.62, r"$z_p = A\,\cos\,\omega t$", va="center")
        model(axes)


def _ball(axes: Axes) -> None:
    height = 1.55
    _mass(axes, height, "")
    axes.plot([0, 0], [PLATE, height - RADIUS], color="0.6", linewidth=0.7, linestyle=(0, (2, 2)))
    axes.text(RADIUS + 0.15, height, "$z_b$", va="center")
    axes.text(0.2, 0.35, r"$\epsilon$", color=LINES["up"], fontsize=12)
    _gravity(axes, height + 0.6)
    axes.text(0, 3.85, "bouncing ball", ha="center", va="top")


def _spring(axes: Axes) -> None:
    lower, upper = PLATE + 0.75, PLATE + 2.75
    _mass(axes, lower, "$m$")
    _mass(axes, upper, "$m$")
    bottom, top = lower + RADIUS, upper - RADIUS
    _coil(axes, -0.3, bottom - 0.18, top + 0.18)
    _damper(axes, 0.3, bottom - 0.18, top + 0.18)
    axes.text(-0.62, (bottom + top) / 2, "$k,\\,L$", va="center", ha="right")
    axes.text(0.62, (bottom + top) / 2, r"$\beta$", va="center")
    axes.text(RADIUS + 0.15, upper, "$z_1$", va="center")
    axes.text(RADIUS + 0.15, lower, "$z_2$", va="center")
    axes.text(0.2, 0.12, r"$\epsilon_{\mathrm{coll}}$", color=LINES["up"], fontsize=12)
    _gravity(axes, upper)
    axes.text(0, 3.85, "bouncing spring", ha="center", va="top")


def _mass(axes: Axes, height: float, text: str) -> None:
    axes.add_patch(Circle((0, height), RADIUS, facecolor="0.82", edgecolor="black", linewidth=1, zorder=4))
    axes.text(0, height, text, ha="center", va="center", zorder=5)


def _coil(axes: Axes, x: float, low: float, high: float) -> None:
    turns = np.linspace(low + 0.25, high - 0.25, 13)
    offset = 0.17 * np.array([0, *([1, -1] * 5), 1, 0])  # as many as turns
    axes.plot([x, *(x + offset), x], [low, *turns, high], color="black", linewidth=1)


def _damper(axes: Axes, x: float, low: float, high: float) -> None:
    middle = (low + high) / 2
    bottom, top = middle - 0.3, middle + 0.22
    axes.plot([x, x, np.nan, x, x], [low, bottom, np.nan, middle, high], color="black", linewidth=1)
    axes.plot(x + 0.17 * np.array([-1, -1, 1, 1]), [top, bottom, bottom, top], color="black", linewidth=1)
    axes.plot([x - 0.13, x + 0.13], [middle, middle], color="black", linewidth=1.6)


def _gravity(axes: Axes, height: float) -> None:
    axes.annotate("", (1.55, height - 0.55), (1.55, height + 0.15), arrowprops=ONE_WAY)
    axes.text(1.68, height - 0.2, "$g$", va="center")
