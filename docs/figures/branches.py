"""Draw figure-branches.png here: cycles (1, 1) over Γ at three frequencies, and the flights of a ramp.

python docs/figures/branches.py
"""

import xarray
from matplotlib.figure import Figure

from bouncing_spring import run
from kernel.cycles.events import Kind, branch_and_events
from kernel.threshold import threshold
from service.pictures import draw_branches, draw_diagram

XI = 0.05
#: Ω, and the last Γ and flight time of its panel: hysteresis, a torus, and beyond the cusp.
PANELS = {0.6: (1.1, 6.6), 0.46: (1.5, 6.6), 0.82: (1.1, 6.6)}
MARKERS = {
    Kind.FOLD: "o", Kind.FLIP: "s", Kind.NEIMARK_SACKER: "D", Kind.IMMEDIATE_TAKEOFF: "^",
    Kind.GRAZE_FLIGHT: "v", Kind.GRAZE_CONTACT: ">",
}  # fmt: skip


def draw(num: int = 351) -> Figure:
    """`num`: values of Γ of the ramps."""
    ramps = run({
        "gamma": {"start": 0.45, "stop": 1.5, "num": num}, "omega": sorted(PANELS), "xi": XI,
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}, "model": {"kind": "rigid"},
        "settle": 300, "observe": 60, "keep": 24,
    })  # fmt: skip
    figure = Figure(figsize=(6.4, 9.0), layout="constrained")
    for axes, (omega, (right, top)) in zip(figure.subplots(3), PANELS.items(), strict=True):
        line, events = branch_and_events(omega, XI, 1, 1200)
        draw_diagram(axes, ramps.sel(omega=omega).squeeze("xi"))
        names = ("gamma", "flight_time", "stable", "violations")
        branch = {name: (("branch", "point"), getattr(line, name)[None]) for name in names}
        draw_branches(axes, xarray.Dataset(branch))
        for kind, marker in MARKERS.items():
            shown = (events.kind == kind) & (events.violations == 0)
            axes.plot(events.gamma[shown], events.flight_time[shown], marker, markersize=5, label=kind)
        axes.plot(threshold(omega, XI), 0.0, "k^", clip_on=False, label=r"$\Gamma_\mathrm{th}$, Eq. 25")
        axes.set(xlim=(0.45, right), ylim=(0, top))
    axes.legend(loc="upper left", fontsize="small")
    return figure


if __name__ == "__main__":
    draw().savefig("figure-branches.png", dpi=150)
