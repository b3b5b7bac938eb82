"""Work-precision measurements: cost and error of the contact models over a fixed set of cells.

The cells are ten lines of eight values of gamma, from those of the paper's figures to extremes: a plate 20
times slower or faster than the spring, no damping, a dashpot that locks, gamma = 100. Each is computed from
rest with a model and with the purpose's reference, an exact soft contact:

    "adhesive"     this contact itself, d = 1e-3, e = 0.01, which may pull
    "nonadhesive"  the same under the law that never pulls
    "plate"        a hard plate without rebound: nonadhesive, d = 1e-7, e = 1e-6

Errors are those of worker.analysis.deviation in the cells whose reference is periodic. Aperiodic cells have
no flights to compare one by one and count only for the agreement of modes.
"""

import math
import time
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.line import run_line
from kernel.params import Line, Outcome
from kernel.step_limits import Scheme, stable_steps_per_contact
from worker.analysis.deviation import FAILED, deviations, percentile
from worker.spec.axes import Strict
from worker.spec.contact_models import CONTACT_MODELS
from worker.tasks import plate_of

SETTLE: Final = 100
OBSERVE: Final = 50

KEEP: Final = 1_024

#: Shorter flights are ignored, rad: with rebound a landing ends in infinitely many ever smaller hops.
MICRO_FLIGHT: Final = 1e-2

#: Timings are repeated for this many core-seconds: single runs are too short for the clock.
MIN_SECONDS: Final = 0.05

_SQRT_HALF: Final = float(np.sqrt(0.5))

#: (Omega, xi, lowest and highest gamma), eight values each, at equal ratios.
LINES: Final = (
    (0.5, 0.26, 1.2, 5.0),  # the paper's Fig. 2
    (0.67, 0.05, 0.8, 3.0),
    (1.0, 0.05, 0.3, 3.0),
    (1.24, 0.05, 1.5, 4.0),
    (2.0, _SQRT_HALF, 1.7, 6.0),
    (0.05, 0.1, 1.1, 3.0),  # a slow plate
    (20.0, 1.0, 2.0, 10.0),  # a fast one
    (0.5, 0.0, 1.2, 5.0),  # no damping
    (5.0, 100.0, 1.1, 10.0),  # a locked dashpot
    (0.5, 0.26, 10.0, 100.0),
)
LOCKED: Final = 8  # index of the line with xi * Omega = 500, where the spring moves like a ball
CELLS_PER_LINE: Final = 8

Purpose = Literal["adhesive", "nonadhesive", "plate"]


class _Cells(NamedTuple):
    """Cells (n,)."""

    gamma: NDArray[np.float64]
    omega: NDArray[np.float64]
    xi: NDArray[np.float64]


class Setup(Strict):
    """One model and its settings; a `restitution` of None is f(xi)."""

    purpose: Purpose
    model: Literal["soft", "stepped", "rigid", "ball"]
    restitution: float | None
    penetration: float | None = None
    adhesive: bool | None = None  # None for models without a law of contact
    steps_per_contact: int | None = None
    scheme: Literal["verlet", "euler"] | None = None
    locked_only: bool = False  # computed on the line with the locked dashpot alone


class Measurement(Setup):
    """Cost of a model in core-microseconds per cell per plate period, and its errors in rad."""

    cost: float | None  # median over the lines; null where all are refused
    cost_most: float | None  # of the most expensive line
    error: float | None  # median over the cells whose reference is periodic; null without one, or if infinite
    error_95: float | None  # 95th percentile
    cells: int  # compared
    agree: float  # share of all cells with the reference's outcome and mode
    unresolved: float  # share of all cells that are unresolved or diverged
    refused: float  # share of all cells for which the steps are unstable


REFERENCES: Final[dict[Purpose, Setup]] = {
    "adhesive": Setup(
        purpose="adhesive", model="soft", restitution=0.01, penetration=1e-3, adhesive=True
    ),
    "nonadhesive": Setup(
        purpose="nonadhesive", model="soft", restitution=0.01, penetration=1e-3, adhesive=False
    ),
    "plate": Setup(purpose="plate", model="soft", restitution=1e-6, penetration=1e-7, adhesive=False),
}  # fmt: skip


#: Measured steps per contact: the paper's rule (Eq. 13) names 20 to 100.
STEPS: Final = (20, 50, 100)
SCHEMES: Final = ("verlet", "euler")

DEPTHS: Final = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def _stepped(
    purpose: Purpose, e: float, d: float, steps: tuple[int, ...], schemes: tuple[str, ...], *, adhesive: bool
) -> tuple[Setup, ...]:
    stepped = Setup(purpose=purpose, model="stepped", restitution=e, penetration=d, adhesive=adhesive)
    return tuple(
        stepped.model_copy(update={"steps_per_contact": n, "scheme": scheme})
        for scheme in schemes
        for n in steps
    )


def _of_contact(purpose: Purpose, *, adhesive: bool) -> tuple[Setup, ...]:
    return (
        REFERENCES[purpose],
        *_stepped(purpose, 0.01, 1e-3, STEPS if adhesive else STEPS[:2], SCHEMES, adhesive=adhesive),
        Setup(purpose=purpose, model="rigid", restitution=0.01),
        Setup(purpose=purpose, model="ball", restitution=None),
        Setup(purpose=purpose, model="ball", restitution=None, locked_only=True),
    )


#: All setups, in the order of the table. `stepped` has fewer settings under the nonadhesive law, and more
#: rebound for a hard plate: that contact is six times shorter than an adhesive one at e = 0.01, and as e goes
#: to 0 its steps would cost a hundred times as much.
SETUPS: Final = (
    *_of_contact("adhesive", adhesive=True),
    *_of_contact("nonadhesive", adhesive=False),
    *(
        Setup(purpose="plate", model="soft", restitution=e, penetration=d, adhesive=adhesive)
        for adhesive, e in ((True, 0.0), (False, 1e-6))
        for d in DEPTHS
    ),
    *_stepped("plate", 1e-6, 1e-2, STEPS, SCHEMES, adhesive=True),
    *_stepped("plate", 1e-6, 1e-3, STEPS, SCHEMES, adhesive=True),
    *_stepped("plate", 1e-2, 1e-2, STEPS, SCHEMES[:1], adhesive=False),
    *_stepped("plate", 1e-2, 1e-3, STEPS[:1], SCHEMES[:1], adhesive=False),
    Setup(purpose="plate", model="rigid", restitution=0.0),
    Setup(purpose="plate", model="ball", restitution=None),
    Setup(purpose="plate", model="ball", restitution=None, locked_only=True),
)


def measure(setup: Setup) -> Measurement:
    """Measure a setup against its reference over all lines, or over the locked one."""
    errors, costs, agree, unresolved, refused = [np.empty(0)], [], 0, 0, 0
    lines = [LINES[LOCKED]] if setup.locked_only else LINES
    for cells in map(_cells, lines):
        if not _is_stable(setup, cells):
            refused += CELLS_PER_LINE
            continue
        exact = _run(REFERENCES[setup.purpose], cells)
        line, cost = _timed(setup, cells)
        costs.append(cost)
        errors.append(deviations(exact, line, MICRO_FLIGHT)[exact.outcome == Outcome.PERIODIC])
        same = [getattr(exact, name) == getattr(line, name) for name in ("outcome", "bounces", "periods")]
        agree += int(np.count_nonzero(np.all(same, axis=0)))
        unresolved += int(np.count_nonzero(np.isin(line.outcome, FAILED)))
    compared, number = np.concatenate(errors), len(lines) * CELLS_PER_LINE
    return Measurement(
        **setup.model_dump(),
        cost=percentile(np.array(costs), 50.0),
        cost_most=percentile(np.array(costs), 100.0),
        error=percentile(compared, 50.0),
        error_95=percentile(compared, 95.0),
        cells=len(compared),
        agree=agree / number,
        unresolved=unresolved / number,
        refused=refused / number,
    )


def _cells(line: tuple[float, float, float, float]) -> _Cells:
    omega, xi, low, high = line
    gamma = np.geomspace(low, high, CELLS_PER_LINE)
    return _Cells(gamma, np.full_like(gamma, omega), np.full_like(gamma, xi))


def _is_stable(setup: Setup, cells: _Cells) -> bool:
    """Whether a specification with these steps would be accepted."""
    if setup.steps_per_contact is None or setup.scheme is None:
        return True
    fewest = stable_steps_per_contact(
        cells.omega, cells.xi, setup.restitution or 0.0, setup.penetration or 0.0,
        adhesive=setup.adhesive is not False, scheme=Scheme[setup.scheme.upper()],
    )  # fmt: skip
    return bool(np.all(setup.steps_per_contact >= fewest))


def _timed(setup: Setup, cells: _Cells) -> tuple[Line, float]:
    """The record, and core-microseconds per cell per plate period.

    The time is the minimum of several runs, which is the least affected by other processes.
    """
    _run(setup, _Cells(*(axis[:1] for axis in cells)), observe=1)  # compiles
    shortest, total = math.inf, 0.0
    while total < MIN_SECONDS:
        began = time.thread_time()
        line = _run(setup, cells)
        took = time.thread_time() - began
        shortest, total = min(shortest, took), total + took
    return line, shortest / CELLS_PER_LINE / (SETTLE + OBSERVE) * 1e6


def _run(setup: Setup, cells: _Cells, observe: int = OBSERVE) -> Line:
    return run_line(
        cells.gamma, cells.omega, cells.xi, plate=plate_of(_contact(setup), *cells), carry=False,
        settle=SETTLE if observe == OBSERVE else 0, observe=observe, keep=KEEP, micro_flight=MICRO_FLIGHT,
    )  # fmt: skip


def _contact(setup: Setup) -> Any:
    """The contact of a specification with this setup."""
    fields = CONTACT_MODELS[setup.model].fields
    values = {name: value for name, value in setup.model_dump().items() if name in fields.model_fields}
    return fields(kind=setup.model, **{name: value for name, value in values.items() if value is not None})
