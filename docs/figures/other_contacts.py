"""Draw figure-other-contacts.png here: Γ_down over the depth of soft contacts, the restitution of rigid ones.

python docs/figures/other_contacts.py
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from worker.analysis.prediction import of_contact
from worker.spec.contact_models import Contact, Rigid, Soft

XI = 0.05
OMEGA = (0.56, 0.6, 0.62, 0.66, 0.7)


def draw_ends(axes: Axes, omega: float, values: NDArray[np.float64], contacts: list[Contact]) -> None:
    """Γ_down of each contact over its value; circles where no fold does, as at Γ_th."""
    ends = [of_contact(contact, omega, XI) for contact in contacts]
    down, at_fold = np.array([end.down for end in ends]), np.array([end.fold is not None for end in ends])
    [dots] = axes.plot(values[at_fold], down[at_fold], ".", label=rf"$\Omega$ = {omega:g}")
    axes.plot(values[~at_fold], down[~at_fold], "o", color=dots.get_color(), markersize=4, fillstyle="none")


def draw(num: int = 36, frequencies: Sequence[float] = OMEGA) -> Figure:
    """`num`: values of depth, and of restitution."""
    depth, restitution = np.logspace(-5, -1, num), np.linspace(0.0, 0.7, num)
    figure = Figure(figsize=(8.6, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for omega in frequencies:
        draw_ends(left, omega, depth, [Soft(penetration=d) for d in depth.tolist()])
        draw_ends(right, omega, restitution, [Rigid(restitution=e) for e in restitution.tolist()])
    left.set(xscale="log", xlabel="depth d of soft contacts, e = 0.01", ylabel=r"$\Gamma_\mathrm{down}$")
    right.set(xlabel="restitution e of rigid contacts")
    figure.legend(*right.get_legend_handles_labels(), loc="outside right center")
    return figure


if __name__ == "__main__":
    draw().savefig("figure-other-contacts.png", dpi=150)
