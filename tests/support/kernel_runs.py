"""The kernel as its tests call it: by its stable entries, with defaults for the arguments."""

import hashlib
import math
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from naive import Setting, State
from plates import Model, plate_of, run_line

from kernel import interface, trajectory
from kernel.models.rigid import RigidPlate
from kernel.models.soft import SoftPlate
from kernel.numerics.first_root import ROOT
from kernel.params import Cell, Line
from kernel.trajectory import Trajectory

TWO_PI = 2.0 * math.pi
#: Every contact model, with values of its contact.
EACH_MODEL = [
    pytest.param(Model.RIGID, {}, id="rigid"),
    pytest.param(Model.RIGID, {"restitution": 0.5}, id="rigid, e = 0.5"),
    pytest.param(Model.SOFT, {"restitution": 0.05}, id="adhesive"),
    pytest.param(Model.SOFT, {"restitution": 0.3, "adhesive": False}, id="nonadhesive"),
    pytest.param(Model.BALL, {"restitution": 0.4}, id="ball"),
    pytest.param(Model.STEPPED, {"restitution": 0.3, "penetration": 2e-2}, id="stepped"),
]


def sample(cell: Cell, contact: dict[str, Any], state: Any, *, model: Model, **options: Any) -> Trajectory:
    """`kernel.trajectory.sample` with the plate of a model in one call; `contact` is of one cell."""
    values = {"restitution": 0.0, "penetration": 1e-3} | contact
    arrays = {
        name: np.array([value]) if name in ("restitution", "penetration") else value
        for name, value in values.items()
    }
    return trajectory.sample(cell, plate_of(model, **arrays), state, **options)


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    """Powers of ten between these exponents."""
    return st.floats(low, high).map(lambda x: 10.0**x)


def examples(count: int) -> settings:
    """Hypothesis settings for `count` fixed examples; KERNEL_EXPLORE=n draws n times as many random ones."""
    explore = int(os.environ.get("KERNEL_EXPLORE", "0"))
    return settings(max_examples=count * max(explore, 1), deadline=None, derandomize=not explore)


def run(
    gamma: Any,
    omega: Any,
    xi: Any,
    which: Model = Model.RIGID,
    *,
    restitution: Any = 0.0,
    penetration: Any = 1e-3,
    adhesive: bool = True,
    settle: int = 40,
    observe: int = 20,
    keep: int = 64,
    carry: bool = False,
    **others: Any,
) -> Line:
    """Run a line; numbers and arrays are broadcast."""
    arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, dtype=float)) for a in (
        gamma, omega, xi, restitution, penetration)))  # fmt: skip
    gamma, omega, xi, restitution, penetration = (np.ascontiguousarray(a) for a in arrays)
    return run_line(
        gamma, omega, xi, model=which, restitution=restitution, penetration=penetration,
        adhesive=adhesive, carry=carry, settle=settle, observe=observe, keep=keep, **others,
    )  # fmt: skip


def compile_models() -> None:
    """Compile the kernels of every model, from rest and as a ramp."""
    for model in Model:
        for carry in (False, True):
            run(1.5, 0.5, 0.26, model, restitution=0.5, penetration=0.1, settle=0, observe=1, carry=carry)


def run_setting(s: Setting, **others: Any) -> Line:
    """Run one cell."""
    return run(
        s.gamma, s.omega, s.xi, Model.SOFT if s.soft else Model.RIGID, restitution=s.restitution,
        penetration=s.penetration, adhesive=s.adhesive, **others,
    )  # fmt: skip


def recorded(line: Line, i: int = 0) -> np.ndarray:
    """The flight times kept of a cell, oldest first."""
    return line.flight_time[i, : min(line.flights[i], line.flight_time.shape[1])]


def last_cycle(line: Line, flights: int) -> np.ndarray:
    """The last `flights` flights of the first cell, sorted."""
    return np.sort(recorded(line)[-flights:])


def part(line: Line, cells: Any) -> Line:
    """Some cells of a line."""
    return Line(*(field[cells] for field in line))


def assert_same_bytes(first: Line, second: Line) -> None:
    for name, a, b in zip(Line._fields, first, second, strict=True):
        assert a.tobytes() == b.tobytes(), name


def digest(line: Line) -> str:
    """SHA-256 of all its bytes."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(field).tobytes() for field in line)).hexdigest()


class Step(NamedTuple):
    """One contact or flight of a trajectory, as computed by the model."""

    flying: bool
    phi: float  # where it began
    before: State
    tau: float
    ending: int
    after: State  # what the next phase begins with
    flies_on: bool
    used: int  # evaluations


def constants(s: Setting) -> Any:
    """The kernel's constants of a setting."""
    restitution = np.array([s.restitution])
    soft = SoftPlate(restitution, np.array([s.penetration]), s.adhesive)
    return interface.prepare(soft if s.soft else RigidPlate(restitution), 0, s.gamma, s.omega, s.xi)


def one_phase(s: Setting, flying: bool, phi: float, state: State, horizon: float, budget: int) -> Step:
    """The contact or flight that begins in this state."""
    follow = interface.flight if flying else interface.contact
    answer = follow(constants(s), interface.plate_phase(phi), interface.State(*state), horizon, budget)
    return Step(flying, phi, state, answer.tau, answer.ending, answer.state, answer.in_flight, answer.used)


def phases(s: Setting, periods: int, limit: int, budget: int = 100_000) -> Iterator[Step]:
    """The first phases from rest, until the window ends, `limit` have passed, or one fails."""
    cell = constants(s)
    phi, passed, state = 0.0, 0.0, interface.rest(cell)
    flying = interface.flies(cell, interface.plate_phase(phi), state)
    for _ in range(limit):
        step = one_phase(s, flying, phi, state, TWO_PI * periods - passed, budget)
        yield step
        if step.ending != ROOT:
            return
        phi, passed = math.fmod(phi + step.tau, TWO_PI), passed + step.tau
        state, flying = step.after, step.flies_on
