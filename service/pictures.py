"""Pictures of results on axes of matplotlib, drawn by the client, by views and for documents.

Needs xarray alone, so that the client stays light; matplotlib is loaded when something is drawn.
"""

from typing import TYPE_CHECKING, Final

import numpy as np
import xarray
from numpy.typing import NDArray

from kernel.labels import LABELS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colours that remain distinct to colour-blind readers and on a photocopy (ColorBrewer's RdBu).
GREY, RED, BLUE = "#a6a6a6", "#b2182b", "#2166ac"
#: Of cells from rest, ramped up, ramped down.
COLOURS: Final = {"rest": "black", "up": RED, "down": BLUE}
_WAYS: Final = {"rest": "from rest", "up": "ramp up", "down": "ramp down"}

#: Of cells on cycles of 1, 2, 3, 4 and more plate periods (Okabe and Ito); of those on none, by their label.
PERIODS: Final = ("#0072b2", "#56b4e9", "#009e73", "#e69f00", "#f0e442")
OTHERS: Final = {
    "at_rest": "#e8e8e8", "aperiodic": "#d55e00", "quasi-periodic": "#cc79a7", "chaotic": "#7f2704",
    "unstable": "#b2182b",
    "settling": "#bdbdbd", "unresolved": "#525252", "diverged": "#000000", "missing": "#ffffff",
}  # fmt: skip

AXES: Final = {
    "gamma": r"plate acceleration over gravity $\Gamma$",
    "omega": r"plate frequency over that of the spring $\Omega$",
    "xi": r"damping ratio $\xi$",
}
SYMBOLS: Final = {"gamma": r"$\Gamma$", "omega": r"$\Omega$", "xi": r"$\xi$"}
FLIGHT: Final = "flight time (rad)"

#: Over the cells of a map whose directions differ, and what a legend calls them.
HATCH: Final = "////"
DIFFER: Final = "up and down differ"


def draw_diagram(ax: "Axes", diagram: xarray.Dataset) -> None:
    """The flights of every cell along the diagram's axis, as dots."""
    *_, along = (str(dim) for dim in diagram.flight_time.dims if dim not in ("direction", "flight"))
    for name in np.atleast_1d(diagram.direction.values):
        line = diagram.sel(direction=name) if diagram.direction.ndim else diagram
        flights = line.flight_time.transpose(along, "flight").values
        x = np.repeat(line[along].values, flights.shape[1])
        way = str(name)
        ax.plot(x, flights.ravel(), ".", markersize=1.5, color=COLOURS[way], label=_WAYS[way])
    ax.set_xlabel(AXES[along])
    ax.set_ylabel(FLIGHT)
    fixed = [f"{SYMBOLS[axis]} = {diagram[axis].item():g}" for axis in AXES if axis != along]
    ax.set_title(", ".join(fixed))


def draw_branches(ax: "Axes", branches: xarray.Dataset) -> None:
    """Cycles of one flight over Γ: solid where stable, dashed where not, thin where they cannot happen."""
    for i in range(branches.sizes["branch"]):
        branch = branches.isel(branch=i)
        gamma, flight = branch.gamma.values, branch.flight_time.values
        stable, admissible = branch.stable.values.astype(bool), branch.admissible.values == 0
        for shown, style, width in (
            (stable & admissible, "-", 1.4),
            (~stable & admissible, "--", 1.0),
            (~admissible, ":", 0.6),
        ):
            x = np.where(shown, gamma, np.nan)
            ax.plot(x, flight, color="black", linestyle=style, linewidth=width)


def draw_modes(ax: "Axes", modes: xarray.Dataset) -> None:
    """The cells of the plane (Γ, Ω) by the plate periods of their cycle, or by what else they do."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    names = [*(f"cycle of {n}" for n in (1, 2, 3, 4)), "longer cycle", *OTHERS]
    codes = modes.label.values if "label" in modes else modes.outcome.values
    periods = np.clip(modes.periods.values, 1, len(PERIODS)) - 1
    cells = np.full(codes.shape, names.index("missing"))
    for code, label in enumerate(LABELS):
        here = codes == code
        cells[here] = periods[here] if label == "periodic" else names.index(label)
    corners = edges(modes.gamma.values), edges(modes.omega.values)
    ax.pcolormesh(
        *corners, cells, rasterized=True,
        cmap=ListedColormap([*PERIODS, *OTHERS.values()]), vmin=-0.5, vmax=len(names) - 0.5,
    )  # fmt: skip
    colours = [*PERIODS, *OTHERS.values()]
    seen = np.unique(cells).tolist()
    handles = [
        Patch(facecolor=colours[i], edgecolor="black", linewidth=0.4, label=names[i].replace("_", " "))
        for i in seen
    ]
    if "hysteresis" in modes and (differ := modes.hysteresis.values > 0).any():
        ax.pcolor(
            *corners, np.ma.masked_where(~differ, differ),
            cmap=ListedColormap(["none"]), edgecolor="none", hatch=HATCH,
        )  # fmt: skip
        handles.append(Patch(facecolor="none", edgecolor="black", linewidth=0.4, hatch=HATCH, label=DIFFER))
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    ax.set_xlabel(AXES["gamma"])
    ax.set_ylabel(AXES["omega"])
    ax.set_title(f"{SYMBOLS['xi']} = {modes.xi.item():g}, periods of the plate in a cycle")


def draw_thresholds(ax: "Axes", thresholds: xarray.Dataset) -> None:
    """Where bouncing begins and ends over Ω: as computed, by Eq. 25, and in closed form."""
    omega = thresholds.omega.values
    ax.plot(omega, thresholds.analytic.values, "--", color="black", linewidth=1.0, label="Eq. 25")
    ax.plot(
        omega, thresholds.predicted_down.values, "-", color=GREY, linewidth=1.4, label="closed form, down"
    )
    for status in ("unresolved", "not searched"):
        number = int((thresholds.cause.values == status).sum()) if "cause" in thresholds else 0
        if number:
            ax.plot([], [], " ", label=f"closed form, {status}: {number} of {len(omega)}")
    for name, marker in (("up", "^"), ("down", "v")):
        values = thresholds[name].values
        if np.isfinite(values).any():
            ax.plot(omega, values, marker, markersize=4, color=COLOURS[name], label=f"computed, {name}")
    ax.set_xlabel(AXES["omega"])
    ax.set_ylabel(r"threshold $\Gamma$")
    ax.set_title(f"{SYMBOLS['xi']} = {thresholds.xi.item():g}")
    ax.legend(frameon=False)


def edges(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ends of the cells around increasing values."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2.0 * values[0] - middle[0]], middle, [2.0 * values[-1] - middle[-1]]])
