"""Draw figure-energy.png here: Γ_down, and the energy that impact and dashpot of the last cycle take.

python docs/figures/energy.py
"""

import numpy as np
from matplotlib.figure import Figure
from tips import soft_landing

from kernel.cycles.thresholds import Thresholds, thresholds
from kernel.threshold import threshold

XI = 0.05


def impact_share(ends: Thresholds) -> float:
    """The percentage of the energy that is lost in the impact; NaN where bouncing does not end at a fold."""
    if ends.fold is None:
        return np.nan
    lost = ends.fold.energy
    return float(100 * lost.impact[0] / (lost.impact + lost.dashpot)[0])


def draw(num: int = 101) -> Figure:
    """`num`: frequencies."""
    omega = np.linspace(0.25, 0.75, num)
    ends = [thresholds(float(value), XI) for value in omega]
    share = np.array(list(map(impact_share, ends)))
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    above.plot(omega, threshold(omega, XI), color="0.7", linewidth=3, label=r"$\Gamma_\mathrm{th}$, Eq. 25")
    above.plot(omega, np.where(np.isfinite(share), [end.down for end in ends], np.nan),
               label=r"$\Gamma_\mathrm{down}$")  # fmt: skip
    below.fill_between(omega, 0, share, color="C3", alpha=0.75, linewidth=0, label="impact")
    below.fill_between(omega, share, 100, color="C0", alpha=0.35, linewidth=0, label="dashpot")
    for j in (1, 2, 3, 4):
        landing = soft_landing(j, 1)[0]
        for axes in (above, below):
            axes.axvline(landing, color="black", linewidth=0.7, linestyle="--")
        above.annotate(rf"$\Omega_{{{j}1}}$", (landing, 1), (0, 3), xycoords=("data", "axes fraction"),
                       textcoords="offset points", ha="center")  # fmt: skip
    above.set(ylabel=r"$\Gamma$", ylim=(0.45, 1.05))
    below.set(xlabel=r"$\Omega$", xlim=(0.25, 0.75), ylabel="lost per cycle (%)", ylim=(0, 100))
    above.legend()
    below.legend(loc="lower right")
    return figure


if __name__ == "__main__":
    draw().savefig("figure-energy.png", dpi=150)
