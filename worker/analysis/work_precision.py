"""Room: what each contact model costs and how far off it is, measured over a fixed set of cells.

The cells are ten lines of eight values of gamma, from the paper's figures to far beyond: a plate
twenty times slower and faster than the spring, no damping, a dashpot that locks, gamma = 100.
Each is computed from rest by a model and by the exact soft contact that stands for what is meant:

    "contact"  the very contact of d = 1e-3, e = 0.01: what a model makes of it
    "plate"    a hard plate without rebound, d = 1e-7, e = 0: what a softer contact makes of it

Errors are those of worker.analysis.deviation where the reference repeats; where it is aperiodic, flights
cannot be told one by one, and cells count for the agreement of modes only. One measurement is a
task like any other: it returns numbers, never data.
"""

import math
import time
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernel.line import run_line
from kernel.params import Line, Outcome
from kernel.step_limits import Scheme, stable_steps_per_contact
from worker.analysis.deviation import deviations, percentile
from worker.spec.axes import Strict
from worker.spec.contact_models import CONTACT_MODELS
from worker.tasks import plate_of

SETTLE: Final = 100
OBSERVE: Final = 50

KEEP: Final = 1_024

#: Flights that count, rad: with rebound a landing ends in ever smaller hops without end.
MICRO_FLIGHT: Final = 1e-2

#: Timed again until so many core-seconds are spent: short ones are at the mercy of the clock.
LEAST_SECONDS: Final = 0.05

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
LOCKED: Final = 8  # the line with xi * Omega = 500, where the spring is a ball
CELLS_A_LINE: Final = 8

Purpose = Literal["contact", "plate"]


class _Cells(NamedTuple):
    """Cells (n,)."""

    gamma: NDArray[np.float64]
    omega: NDArray[np.float64]
    xi: NDArray[np.float64]


class Rung(Strict):
    """One model and its settings; of `restitution` None is f(xi)."""

    purpose: Purpose
    model: Literal["soft", "stepped", "rigid", "ball"]
    restitution: float | None
    penetration: float | None = None
    steps_per_contact: int | None = None
    scheme: Literal["verlet", "euler"] | None = None
    locked_only: bool = False  # on the line with the locked dashpot alone


class Measured(Rung):
    """What a rung costs, core-microseconds a cell and plate period, and how far off it is, rad."""

    cost: float | None  # median over the lines; null where all are refused
    cost_most: float | None  # of the dearest line
    error: float | None  # median over the cells whose reference repeats; null without one, or bound
    error_95: float | None  # 95th percentile
    cells: int  # compared
    agree: float  # share of all cells with the reference's outcome and mode
    unresolved: float  # share of all cells without an answer
    refused: float  # share of all cells for which the steps are unstable


REFERENCES: Final[dict[Purpose, Rung]] = {
    "contact": Rung(purpose="contact", model="soft", restitution=0.01, penetration=1e-3),
    "plate": Rung(purpose="plate", model="soft", restitution=0.0, penetration=1e-7),
}


def _stepped(purpose: Purpose, e: float, d: float, steps: tuple[int, ...]) -> tuple[Rung, ...]:
    one = Rung(purpose=purpose, model="stepped", restitution=e, penetration=d)
    settings = [(n, scheme) for scheme in ("verlet", "euler") for n in steps]
    return tuple(one.model_copy(update={"steps_per_contact": n, "scheme": scheme}) for n, scheme in settings)


def _soft(purpose: Purpose, e: float, *depths: float) -> tuple[Rung, ...]:
    return tuple(Rung(purpose=purpose, model="soft", restitution=e, penetration=d) for d in depths)


#: All that is measured.
RUNGS: Final = (
    REFERENCES["contact"],
    *_stepped("contact", 0.01, 1e-3, (20, 50, 100)),
    Rung(purpose="contact", model="rigid", restitution=0.01),
    Rung(purpose="contact", model="ball", restitution=None),
    Rung(purpose="contact", model="ball", restitution=None, locked_only=True),
    *_soft("plate", 0.0, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
    *_stepped("plate", 1e-6, 1e-2, (20, 50, 100)),
    *_stepped("plate", 1e-6, 1e-3, (20, 50, 100)),
    Rung(purpose="plate", model="rigid", restitution=0.0),
    Rung(purpose="plate", model="ball", restitution=None),
    Rung(purpose="plate", model="ball", restitution=None, locked_only=True),
)


class _Part(NamedTuple):
    """A rung on one line of cells, beside its reference."""

    errors: NDArray[np.float64]  # of the cells whose reference repeats
    cost: float | None  # core-microseconds a cell and plate period
    agree: int
    unresolved: int
    refused: int


def measure(rung: Rung) -> Measured:
    """Run a rung and its reference over the cells it is for."""
    lines = [LINES[LOCKED]] if rung.locked_only else LINES
    parts = [_on_line(rung, _cells(line)) for line in lines]
    errors = np.concatenate([part.errors for part in parts])
    costs = np.array([part.cost for part in parts if part.cost is not None])
    cells = len(lines) * CELLS_A_LINE
    return Measured(
        **rung.model_dump(),
        cost=percentile(costs, 50.0),
        cost_most=percentile(costs, 100.0),
        error=percentile(errors, 50.0),
        error_95=percentile(errors, 95.0),
        cells=len(errors),
        agree=sum(part.agree for part in parts) / cells,
        unresolved=sum(part.unresolved for part in parts) / cells,
        refused=sum(part.refused for part in parts) / cells,
    )


def _on_line(rung: Rung, cells: _Cells) -> _Part:
    if not _stable(rung, cells):
        return _Part(np.empty(0), None, 0, 0, CELLS_A_LINE)
    exact = _run(REFERENCES[rung.purpose], cells)
    found, cost = _timed(rung, cells)
    same = (
        (exact.outcome == found.outcome) & (exact.bounces == found.bounces) & (exact.periods == found.periods)
    )
    errors = deviations(exact, found, MICRO_FLIGHT)[exact.outcome == Outcome.PERIODIC]
    unresolved = np.count_nonzero(found.outcome >= Outcome.UNRESOLVED)
    return _Part(errors, cost, int(np.count_nonzero(same)), int(unresolved), 0)


def _cells(line: tuple[float, float, float, float]) -> _Cells:
    omega, xi, low, high = line
    gamma = np.geomspace(low, high, CELLS_A_LINE)
    return _Cells(gamma, np.full_like(gamma, omega), np.full_like(gamma, xi))


def _stable(rung: Rung, cells: _Cells) -> bool:
    """Whether a specification with these steps would be accepted."""
    if rung.steps_per_contact is None or rung.scheme is None:
        return True
    fewest = stable_steps_per_contact(
        cells.omega, cells.xi, rung.restitution or 0.0, rung.penetration or 0.0,
        scheme=Scheme[rung.scheme.upper()],
    )  # fmt: skip
    return bool(np.all(rung.steps_per_contact >= fewest))


def _timed(rung: Rung, cells: _Cells) -> tuple[Line, float]:
    """The record, and core-microseconds a cell and plate period: the least of several, so that neighbours
    on the machine count as little as can be."""
    _run(rung, _Cells(*(axis[:1] for axis in cells)), observe=1)  # compiles
    least, spent = math.inf, 0.0
    while spent < LEAST_SECONDS:
        began = time.thread_time()
        found = _run(rung, cells)
        took = time.thread_time() - began
        least, spent = min(least, took), spent + took
    return found, least / CELLS_A_LINE / (SETTLE + OBSERVE) * 1e6


def _run(rung: Rung, cells: _Cells, observe: int = OBSERVE) -> Line:
    return run_line(
        cells.gamma, cells.omega, cells.xi, plate=plate_of(_contact(rung), *cells), carry=False,
        settle=SETTLE if observe == OBSERVE else 0, observe=observe, keep=KEEP, micro_flight=MICRO_FLIGHT,
    )  # fmt: skip


def _contact(rung: Rung) -> Any:
    """What a specification would say of this rung."""
    fields = CONTACT_MODELS[rung.model].fields
    said = {name: value for name, value in rung.model_dump().items() if name in fields.model_fields}
    return fields(kind=rung.model, **{name: value for name, value in said.items() if value is not None})
