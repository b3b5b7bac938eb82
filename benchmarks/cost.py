"""Cost of a cell against Gamma, Omega, xi, penetration, settling periods and the size of the grid.

    python -m benchmarks.cost [--repeat 5] [-o docs/cost.png]
    python -m benchmarks.cost --estimates [--repeat 5]

The kernel alone on one core, CPU microseconds per cell per plate period: one quantity varies, the others are
Gamma = 2, Omega = 0.5, xi = 0.26, d = 1e-3, 200 + 100 periods; 64 cells within 1% of Gamma, medians. The size
of the grid: whole sweeps over HTTP on the embedded cluster of two workers, from submission to completion.
"exponent" is that of the total time against the quantity, between its ends (1: proportional). The cost should
not depend on Gamma, Omega, xi and d: see the ratio of the largest to the smallest.

`--estimates`: of every model, law and protocol, what is expected of a cell by default beside what it takes on
average, and that relative to every cycle computed, 200 + 100 periods and those in which cells without a mode
are followed: random cells from rest (Gamma 0.3 to 6, Omega 0.2 to 2, xi 0.01 to 1), and 16 lines of 50 values
of Gamma.
"""

import math
import statistics
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.kernel import NEIGHBOURS, cost_of, line
from benchmarks.measuring import describe, options, short, table
from benchmarks.scaling import sweep_seconds, warmed
from kernel.line import run_line
from tests.support.plates import Model
from worker.sweep import SweepSpec
from worker.sweep.plan import cell_seconds
from worker.work import plate_of

USUAL: dict[str, Any] = {"gamma": 2.0, "omega": 0.5, "xi": 0.26, "settle": 200, "observe": 100, "d": 1e-3}
KINDS = {"rigid": Model.RIGID, "soft": Model.SOFT}
AXES: dict[str, Sequence[float]] = {
    "gamma": (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 30.0, 100.0),
    "omega": (0.01, 0.03, 0.1, 0.3, 0.5, 1.0, 2.0, 5.0, 20.0, 100.0),
    "xi": (0.001, 0.01, 0.05, 0.1, 0.26, 0.5, 1.0, 2.0, 5.0, 20.0),
    "d": (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1),
    "settle": (100, 200, 500, 1000, 2000, 5000),
}
LABELS = {"gamma": "Γ", "omega": "Ω", "xi": "ξ", "d": "d", "settle": "settle, periods", "cells": "cells"}
#: Values of Omega with 1000 of Gamma and 1 of xi.
SIZES = (1, 3, 10, 30, 100)

#: Contacts of `--estimates`, and the cells from rest of each.
ESTIMATES: dict[str, tuple[dict[str, Any], int]] = {
    "rigid": ({"kind": "rigid"}, 4000),
    "rigid, e = 0.3": ({"kind": "rigid", "restitution": 0.3}, 1000),
    "soft, adhesive, d = 1e-3": ({"kind": "soft"}, 1000),
    "soft, adhesive, d = 1e-6": ({"kind": "soft", "penetration": 1e-6}, 1000),
    "soft, nonadhesive, d = 1e-3": ({"kind": "soft", "adhesive": False}, 1000),
    "soft, nonadhesive, d = 1e-6": ({"kind": "soft", "adhesive": False, "penetration": 1e-6}, 1000),
    "ball": ({"kind": "ball"}, 4000),
    "ball, e = 0.3": ({"kind": "ball", "restitution": 0.3}, 4000),
    "stepped, adhesive": ({"kind": "stepped"}, 16),
    "stepped, nonadhesive": ({"kind": "stepped", "adhesive": False}, 16),
}
RAMP_LINES, RAMP_LENGTH = 16, 50

Curve = list[tuple[float, float]]


def kernel_curve(kind: str, axis: str, repeat: int) -> Curve:
    """(value, microseconds per cell per plate period) along an axis."""
    curve = []
    for value in AXES[axis]:
        at = USUAL | {axis: value}
        gamma = at["gamma"] * np.linspace(0.99, 1.01, NEIGHBOURS)

        def run(g: np.ndarray = gamma, a: dict[str, Any] = at) -> object:
            return line(
                g, a["omega"], a["xi"], KINDS[kind], e=0.01 if kind == "soft" else 0.0, d=a["d"],
                settle=int(a["settle"]), observe=int(a["observe"]),
            )  # fmt: skip

        periods = at["settle"] + at["observe"]
        curve.append((float(value), cost_of(run, NEIGHBOURS * periods, repeat)))
    return curve


def size_curve(repeat: int) -> Curve:
    """(cells, microseconds of wall time per cell per plate period) of whole sweeps on two workers."""
    with warmed(2) as client:
        walls = [
            statistics.median(sweep_seconds(client, omegas, 1) for _ in range(repeat)) for omegas in SIZES
        ]
    return [(1000.0 * n, wall / n / 0.3) for n, wall in zip(SIZES, walls, strict=True)]


def estimate_row(name: str, ramp: bool, repeat: int) -> list[str]:
    """What a contact's cells take, and what they are estimated to take."""
    model, cells = ESTIMATES[name]
    random = np.random.default_rng(1)
    ends = {"gamma": (0.3, 6.0), "omega": (0.2, 2.0)}
    lines = 1 if name.startswith("stepped") else RAMP_LINES
    n = lines if ramp else cells
    gamma, omega = (random.uniform(*ends[axis], n) for axis in ends)
    xi = 10 ** random.uniform(-2, 0, n)
    if ramp:
        length = 8 if name.startswith("stepped") else RAMP_LENGTH
        gamma = np.tile(np.linspace(*ends["gamma"], length), n)
        omega, xi = np.repeat(omega, length), np.repeat(xi, length)
    axes = {axis: {"start": low, "stop": high, "num": 100} for axis, (low, high) in ends.items()}
    xis = {"start": 0.01, "stop": 1.0, "num": 100, "spacing": "log"}
    protocol = {"kind": "ramp", "axis": "gamma", "direction": "up"} if ramp else {"kind": "rest"}
    spec = SweepSpec(**axes, xi=xis, model=model, protocol=protocol)
    fixed = spec.model_copy(update={"settle": spec.window[0]})
    plate = plate_of(spec.model, gamma, omega, xi)

    def run(spec: SweepSpec) -> object:
        return run_line(
            gamma, omega, xi, plate=plate, carry=ramp, settle=spec.window[0], observe=spec.observe,
            keep=spec.keep, micro_flight=spec.micro_flight, certify=spec.certifies,
            settle_until=spec.settles_until, start=[None] * n if ramp else None,
        )  # fmt: skip

    periods = sum(spec.window)
    repeat = 1 if name.startswith("stepped") else repeat
    took, whole = (cost_of(partial(run, each), len(gamma) * periods, repeat) for each in (spec, fixed))
    expected = cell_seconds(spec) / periods * 1e6
    ratios = f"{expected / took:.2f}", f"{took / whole:.2f}"
    return [f"{name}, {protocol['kind']}", short(took), short(expected), *ratios]


def exponent(curve: Curve) -> float:
    """Exponent of the total time against the quantity, between its ends."""
    (first, first_cost), (last, last_cost) = curve[0], curve[-1]
    return math.log(last_cost * last / (first_cost * first)) / math.log(last / first)


def row(name: str, axis: str, curve: Curve) -> tuple[str, ...]:
    """One row of the table."""
    costs = [cost for _, cost in curve]
    span = f"{curve[0][0]:g} to {curve[-1][0]:g}"
    linear = f"{exponent(curve):.2f}" if axis in ("settle", "cells") else ""
    least, most = min(costs), max(costs)
    return (name, LABELS[axis], span, *map(short, (least, most, most / least)), linear)


def draw(curves: dict[str, dict[str, Curve]], file: str) -> None:
    """Draw the figure, one panel per quantity."""
    figure = Figure(figsize=(11, 6), layout="constrained")
    for panel, (axis, lines) in zip(figure.subplots(2, 3).flat, curves.items(), strict=True):
        for kind, curve in lines.items():
            panel.loglog(*zip(*curve, strict=True), "o-", label=kind, markersize=3.5, linewidth=1.2)
        panel.set_xlabel(LABELS[axis])
        panel.set_ylim(bottom=0.004)
        panel.grid(alpha=0.3)
        panel.legend(frameon=False, fontsize=8)
    figure.supylabel("µs per cell per plate period")
    figure.savefig(file, dpi=110)


def main() -> None:
    """Print the table and draw the figure."""
    arguments = options(__doc__, repeat=5, output="docs/cost.png", estimates=False)
    print(describe("dask", "zarr"), flush=True)
    if arguments.estimates:
        rows = []
        for name in ESTIMATES:
            for ramp in (False, True):
                rows.append(estimate_row(name, ramp, arguments.repeat))
                print(*rows[-1], flush=True)
        print(
            "\n"
            + table(["", "taken, µs per plate period", "estimated, µs", "ratio", "of every cycle's"], rows)
        )
        return
    curves: dict[str, dict[str, Curve]] = {}
    for axis in AXES:
        kinds = ("soft",) if axis == "d" else KINDS
        curves[axis] = {kind: kernel_curve(kind, axis, arguments.repeat) for kind in kinds}
    curves["cells"] = {"rigid, two workers, wall time": size_curve(min(arguments.repeat, 3))}
    rows = [row(kind, axis, curve) for axis, lines in curves.items() for kind, curve in lines.items()]
    head = ["", "against", "range", "smallest, µs", "largest, µs", "largest/smallest", "exponent"]
    print("\n" + table(head, rows))
    draw(curves, arguments.output)
    print(f"\n{arguments.output}")


if __name__ == "__main__":
    main()
