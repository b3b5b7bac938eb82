"""Cost of Lyapunov exponents: cells with them beside the same cells without.

    python -m benchmarks.exponents [--cells 60] [--repeat 7]

Up ramps of Gamma from 1.2 to 6 at Omega = 0.5, xi = 0.26 and at Omega = 1, xi = 0.05; settle 200, observe
100. A ramp goes through the scalar loop, with and without exponents. Beside it, for `rigid`, the same cells
from rest, which without exponents are computed in lanes. The runs of a row alternate, so that a change in the
machine's speed meets all of them. Core-microseconds per cell and plate period, medians; ratios to the scalar
run without exponents.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.measuring import alternating, describe, options, short, table
from kernel import line
from kernel.params import Line
from tests.support.plates import Model, plate_of

SETTLE, OBSERVE = 200, 100
SETTINGS = ((0.5, 0.26), (1.0, 0.05))

#: model, restitution, penetration, adhesive, exponents
ROWS = (
    ("rigid, e = 0", Model.RIGID, 0.0, 1e-3, True, (1, 2, 3)),
    ("rigid, e = 0.3", Model.RIGID, 0.3, 1e-3, True, (1, 2, 4)),
    ("soft, adhesive", Model.SOFT, 0.01, 1e-3, True, (1, 2, 4)),
    ("soft, nonadhesive", Model.SOFT, 0.01, 1e-3, False, (1, 2, 4)),
    ("ball, e = 0.5", Model.BALL, 0.5, 1e-3, True, (1, 2)),
)


def run(plate: object, cells: tuple[np.ndarray, ...], exponents: int, in_lanes: bool = False) -> Line:
    """The cells as an up ramp; `in_lanes`: from rest, side by side."""
    gamma, omega, xi = cells
    return line.run_line(
        gamma, omega, xi, plate=plate, carry=not in_lanes, in_lanes=in_lanes, settle=SETTLE,
        observe=OBSERVE, keep=64, exponents=exponents,
    )  # fmt: skip


def main() -> None:
    arguments = options(__doc__, cells=60, repeat=7)
    print(describe())
    n = arguments.cells
    gamma = np.tile(np.linspace(1.2, 6.0, n), len(SETTINGS))
    omega, xi = (np.repeat([setting[i] for setting in SETTINGS], n) for i in (0, 1))
    cells = (gamma, omega, xi)
    per_period = 1e6 / (len(gamma) * (SETTLE + OBSERVE))
    rows = []
    for name, model, e, d, adhesive, counts in ROWS:
        plate = plate_of(model, np.full(len(gamma), e), np.full(len(gamma), d), adhesive)
        runs: list[Callable[[], Line]] = [partial(run, plate, cells, k) for k in (0, *counts)]
        if model is Model.RIGID:
            runs.append(partial(run, plate, cells, 0, in_lanes=True))
        spent = np.median(alternating(runs, arguments.repeat), axis=0)
        ratios = {count: f"{spent[i + 1] / spent[0]:.2f}" for i, count in enumerate(counts)}
        in_lanes = f"{spent[-1] / spent[0]:.2f}" if model is Model.RIGID else "-"
        others = [ratios.get(count, "-") for count in (1, 2, 3, 4)]
        rows.append([name, short(spent[0] * per_period), in_lanes, *others])
    head = ["contact", "scalar run, us", "lanes", *(f"{count} exponents" for count in (1, 2, 3, 4))]
    print(table(head, rows))


if __name__ == "__main__":
    main()
