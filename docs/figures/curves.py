"""Draw figure-curves.png here: events of the cycles (1, 1) over Ω, and where hysteresis ends.

python docs/figures/curves.py
"""

import numpy as np
from matplotlib.figure import Figure
from tips import Tip, deepest, end_of_hysteresis, tip

from kernel.cycles.curves import Parameter, curves
from kernel.cycles.events import Kind
from kernel.threshold import threshold

XI = 0.05
OMEGAS = (0.25, 0.86)
STYLES = {Kind.FOLD: "C0-", Kind.FLIP: "C1--", Kind.NEIMARK_SACKER: "C2:"}
POINTS = {Kind.CUSP: "C0o", Kind.BOGDANOV_TAKENS: "C2D"}


def depth(lowest: Tip) -> float:
    """How far a tip lies below Γ_th, relative to it."""
    return 1.0 - lowest.gamma / float(threshold(lowest.omega, lowest.xi))


def draw(lines: int = 13, tips: int = 4) -> Figure:
    """`lines`: frequencies at which curves are sought; `tips`: minima of Γ_down that are drawn."""
    found = curves(Parameter.OMEGA, XI, *OMEGAS, 1, tuple(STYLES), lines=lines)
    figure = Figure(figsize=(6.4, 7.2), layout="constrained")
    above, below = figure.subplots(2)
    grid = np.linspace(*OMEGAS, 600)
    above.plot(grid, threshold(grid, XI), color="0.7", linewidth=3, label=r"$\Gamma_\mathrm{th}$, Eq. 25")
    for curve in found.curves:
        gamma = np.where(curve.violations == 0, curve.gamma, np.nan)
        above.plot(curve.omega, gamma, STYLES[curve.kind[0]])
    for kind, style in STYLES.items():
        above.plot([], [], style, label=kind)
    for kind, style in POINTS.items():
        shown = (found.points.kind == kind) & (found.points.violations == 0)
        above.plot(found.points.omega[shown], found.points.gamma[shown], style, mfc="white", label=kind)
    for j in range(1, tips + 1):
        name, lowest, end = rf"$\Omega_{{{j}1}}$", tip(j, 1, XI), end_of_hysteresis(j, 1)
        above.annotate(name, (lowest.omega, lowest.gamma), (0, -12), textcoords="offset points", ha="center")
        xi = np.linspace(0.004, end.xi, 24)
        below.plot(xi, [depth(deepest(j, 1, float(value))) for value in xi], label=name)
        below.plot(end.xi, depth(end), "o", color=below.lines[-1].get_color(), mfc="white")
    above.set(xlim=OMEGAS, ylim=(0.42, 1.45), xlabel=r"$\Omega$", ylabel=r"$\Gamma$")
    below.set(xlabel=r"$\xi$", ylabel=r"$1 - \Gamma_\mathrm{down}/\Gamma_\mathrm{th}$", ylim=(0, 1))
    above.legend()
    below.legend()
    return figure


if __name__ == "__main__":
    draw().savefig("figure-curves.png", dpi=150)
