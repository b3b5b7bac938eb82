"""Draw figure-steps.png here: flights near Γ = 2 of Fig. 7b, exact, with located and with plain steps.

python docs/figures/steps.py
"""

import numpy as np
import xarray
from matplotlib.figure import Figure

from bouncing_spring import run
from kernel.params import Outcome
from service.pictures import draw_diagram
from service.presets import GAMMA_NEAR_TWO, XI

#: Restitution and scheme of each row; the paper's restitution is "as closest as possible to zero".
ROWS = ((0.1, "verlet"), (1e-6, "euler"))
#: rad; shorter flights do not count.
MICRO = 0.05


def sweep(restitution: float, num: int, **steps: str) -> xarray.Dataset:
    """The cells near Γ = 2, exact or with 20 steps per contact."""
    model = {"restitution": restitution, "penetration": 1e-3, **steps}
    gamma = {**GAMMA_NEAR_TWO, "num": num}
    cells = {"gamma": gamma, "omega": 1.0, "xi": XI, "model": model, "micro_flight": MICRO}
    return run({**cells, "settle": 300, "keep": 128}).squeeze(["direction", "xi", "omega"])


def deviations(stepped: xarray.Dataset, exact: xarray.Dataset) -> np.ndarray:
    """(n,) rad: for n cells with an exact cycle, how far stepped flights lie at most from it."""
    largest = []
    for gamma in exact.gamma[exact.outcome == Outcome.PERIODIC]:
        times = [diagram.flight_time.sel(gamma=gamma).values for diagram in (stepped, exact)]
        flights, cycle = (time[time > MICRO] for time in times)
        largest.append(np.abs(flights[:, None] - cycle).min(axis=1).max())
    return np.array(largest)


def draw(num: int = GAMMA_NEAR_TWO["num"]) -> tuple[Figure, dict[tuple[str, str], np.ndarray]]:
    """The figure, and the deviations by scheme and events; `num`: values of Γ."""
    figure, errors = Figure(figsize=(9.6, 6.0), layout="constrained"), {}
    panels = figure.subplots(len(ROWS), 3, sharex=True, sharey="row")
    for (restitution, scheme), row in zip(ROWS, panels, strict=True):
        exact = sweep(restitution, num)
        draw_diagram(row[0], exact)
        row[0].set_title(f"exact, $e$ = {restitution:g}", fontsize=10)
        for axes, events in zip(row[1:], ("located", "plain"), strict=True):
            stepped = sweep(restitution, num, kind="stepped", scheme=scheme, events=events)
            draw_diagram(axes, stepped)
            errors[scheme, events] = off = deviations(stepped, exact)
            axes.set_title(f"{scheme.title()}, {events}: up to {off.max():.1g} rad off", fontsize=10)
    for axes in panels.flat:
        axes.label_outer()
    return figure, errors


if __name__ == "__main__":
    figure, errors = draw()
    rows = (f"{' '.join(names)}: median {np.median(off):.1g} rad" for names, off in errors.items())
    figure.savefig("figure-steps.png", dpi=110, metadata={"Description": ", ".join(rows)})
