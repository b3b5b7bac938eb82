"""The motion of one cell while the caller waits: plate, masses and contact force, sample by sample."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationError, model_validator

from kernel.branches.energy import Energy, energy
from kernel.branches.events import Branch, branch
from kernel.branches.starts import CycleStart, start_on_cycle, start_on_stable_cycle
from kernel.params import Cell, KernelInputError, Outcome
from kernel.trajectory import Trajectory, sample
from service.errors import InvalidRequest, TooLarge
from service.results.selection import (
    Stored,
    Sweep,
    check_kernel,
    nearest_index,
    read,
    read_stored,
    resolve_direction,
)
from worker import schema
from worker.basins.spec import MAX_HEIGHT, BasinSpec, MultistabilitySpec
from worker.basins.starts import contact_states, drop_states
from worker.cost import period_seconds
from worker.spec import AXES, LARGEST, SMALLEST, SweepSpec, parsing
from worker.spec.axes import NUMBER, WHOLE, Strict
from worker.spec.contact_models import Contact, Rigid, Soft, model_fields, penetration_of
from worker.spec.errors import BrokenRuleError, SpecInvalid, describe, one_of, problems_of
from worker.spec.protocols import MAX_START_PERIODS, OnCycle
from worker.spec.sweep import WITH_CYCLES, no_cycle
from worker.tasks import plate_of, run_cells

#: Samples in one answer.
MAX_SAMPLES: Final = 20_000
#: Bytes of memory that a sample takes, with its numbers as text.
BYTES_PER_SAMPLE: Final = 1_000

#: A motion whose take-offs are this near to a period apart, rad, is a cycle.
SETTLED: Final = 1e-6

#: Plate periods before the first sample.
MAX_SETTLE: Final = 1_000_000

#: Where the model has no rest length, the spring is drawn 1e4 contact depths long, as in the paper.
DEPTH_OVER_LENGTH: Final = 1e-4


#: Flight times of cycles are below this, rad.
_LONGEST: Final = 2.0 * np.pi * MAX_START_PERIODS


def _kind(value: object) -> object:
    if value != "cycle":
        raise BrokenRuleError("", f"must be {one_of(tuple(_STARTS))}, not {describe(value)}")
    return value


class CyclePoint(OnCycle):
    """A cycle of the closed form to start on.

    `flight_time`, rad: of the cell's cycles the one whose flight takes nearest to it, unstable ones too.
    Null: the stable one with the longest flight.
    """

    kind: Annotated[Literal["cycle"], BeforeValidator(_kind)] = "cycle"
    flight_time: Annotated[float, Field(gt=0.0, lt=_LONGEST), NUMBER] | None = None


class DropStart(Strict):
    """A spring that is let go: relaxed, both masses at rest in the laboratory (docs/basins.md, "Planes").

    `height`: of the lower mass above the plate, plate amplitudes; `phase`: of the plate, rad.
    """

    kind: Literal["drop"]
    height: Annotated[float, Field(gt=0.0, le=MAX_HEIGHT), NUMBER]
    phase: Annotated[float, Field(ge=0.0, lt=2.0 * np.pi), NUMBER] = 0.0


class ContactStart(Strict):
    """A state of contact at phase 0 of the plate (docs/basins.md, "Planes").

    `elongation`: beyond the static one, plate amplitudes; `velocity`: of the elongation, times omega.
    """

    kind: Literal["contact"]
    elongation: Annotated[float, Field(ge=-MAX_HEIGHT, le=MAX_HEIGHT), NUMBER]
    velocity: Annotated[float, Field(ge=-MAX_HEIGHT, le=MAX_HEIGHT), NUMBER] = 0.0


#: The starts by kind.
_STARTS: Final[dict[str, type[Strict]]] = {"cycle": CyclePoint, "drop": DropStart, "contact": ContactStart}


def _start_tag(value: object) -> str:
    """Tags of the kinds of starts; a start without a known kind is read as a cycle, which names the kinds."""
    if value is None:
        return "<rest>"
    kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
    return f"<{kind}>" if isinstance(kind, str) and kind in _STARTS else "<cycle>"


class TrajectorySpec(Strict):
    """One cell, the plate periods before and during the samples, and the samples per period.

    With a `start` the samples begin on a cycle, with a drop or in contact, and `settle` is 0.
    """

    gamma: Annotated[float, Field(ge=SMALLEST, le=LARGEST), NUMBER]
    omega: Annotated[float, Field(ge=SMALLEST, le=LARGEST), NUMBER]
    xi: Annotated[float, Field(ge=0.0, le=LARGEST), NUMBER]
    model: Contact = Soft()
    settle: Annotated[int, Field(ge=0, le=MAX_SETTLE), WHOLE] = 200
    periods: Annotated[int, Field(ge=1, le=MAX_SAMPLES), WHOLE] = 4
    samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES), WHOLE] = 200
    start: Annotated[
        Annotated[CyclePoint, Tag("<cycle>")]
        | Annotated[DropStart, Tag("<drop>")]
        | Annotated[ContactStart, Tag("<contact>")]
        | Annotated[None, Tag("<rest>")],
        Discriminator(_start_tag),
    ] = None

    def __init__(self, /, **data: object) -> None:
        if data.get("start") is not None:
            data = {"settle": 0} | data
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise SpecInvalid(problems_of(error, _fields())) from None

    @model_validator(mode="after")
    def _starts_elsewhere_than_at_rest(self) -> Self:
        if self.start is None:
            return self
        if self.settle:
            rule = (
                "must be 0 with a start on a cycle"
                if self.start.kind == "cycle"
                else "must be 0 with a start"
            )
            raise BrokenRuleError("settle", f"{rule}, not {self.settle}")
        if self.start.kind != "drop" and self.model.kind not in WITH_CYCLES:
            rule = f"needs a spring, and model.kind is {self.model.kind!r}; {one_of(WITH_CYCLES)} works"
            raise BrokenRuleError("start", rule)
        return self

    @classmethod
    def from_json(cls, text: bytes) -> Self:
        """From JSON text. Raises SpecUnreadable or SpecInvalid."""
        return cls(**parsing.fields_of(parsing.read_json(text), "a trajectory"))

    def sweep(self) -> SweepSpec:
        """The sweep of this one cell that ends where the samples begin. Raises SpecInvalid."""
        return SweepSpec(
            gamma=self.gamma, omega=self.omega, xi=self.xi, model=self.model,
            settle=max(self.settle - 1, 0), observe=1, keep=1,
        )  # fmt: skip


def _fields() -> dict[str, tuple[str, ...]]:
    return {
        "": tuple(TrajectorySpec.model_fields),
        **{f"<{kind}>": tuple(start.model_fields) for kind, start in _STARTS.items()},
        **model_fields(),
    }


@dataclass(frozen=True)
class Motion:
    """A sampled trajectory and the rest length the spring is drawn with, in plate amplitudes."""

    spec: TrajectorySpec
    trajectory: Trajectory
    rest_length: float
    cycle: Branch | None = None  # of one point: the cycle that it starts on


def check_cost(spec: TrajectorySpec, max_seconds: float) -> None:
    """Raise TooLarge for more samples or more computing than one answer may take, SpecInvalid as `sweep`."""
    sweep = spec.sweep()
    samples = spec.periods * spec.samples + 1
    if samples > MAX_SAMPLES:
        raise TooLarge(
            f"periods × samples: {samples:,} samples; the limit is {MAX_SAMPLES:,}, "
            f"{max((MAX_SAMPLES - 1) // spec.periods, 1):,} per period"
        )
    periods = spec.settle + spec.periods
    seconds = period_seconds(sweep, alone=True) * periods
    if seconds > max_seconds:
        fitting = int(periods * max_seconds / seconds)
        raise TooLarge(
            f"settle: {periods:,} periods of this contact take about {seconds:.3g} s; the limit for one "
            f"answer is {max_seconds:g} s: submit a sweep, or settle for {fitting:,} periods"
        )


def compute(spec: TrajectorySpec, state: NDArray[np.float64] | None = None) -> Motion:
    """The motion after `settle` periods from rest, from the start, or from a state in the cell's units.

    Raises InvalidRequest where the cell has no answer to settle to, or no such cycle.
    """
    gamma, omega, xi = (np.array([value]) for value in (spec.gamma, spec.omega, spec.xi))
    depth = penetration_of(spec.model, gamma, omega)
    cycle = None
    if isinstance(spec.start, CyclePoint):
        start, cycle = _on_cycle(Cell(spec.gamma, spec.omega, spec.xi), spec.start)
        state = start.state
    elif isinstance(spec.start, DropStart):
        state = drop_states(np.array(spec.start.height), np.array(spec.start.phase))
    elif isinstance(spec.start, ContactStart):
        place = (np.array(spec.start.elongation), np.array(spec.start.velocity))
        state = contact_states(spec.model, (spec.gamma, spec.omega, spec.xi), *place)
    if state is None and spec.settle:
        state = _settled(spec.sweep(), gamma, omega, xi)
    trajectory = sample(
        Cell(spec.gamma, spec.omega, spec.xi),
        plate_of(spec.model, gamma, omega, xi),
        state,
        periods=spec.periods,
        samples=spec.samples,
    )
    return Motion(spec, trajectory, float(depth[0]) / DEPTH_OVER_LENGTH, cycle)


def cycle_energy(motion: Motion) -> Energy | None:
    """The balance of a cycle, if the samples show one of one bounce on a rigid plate without restitution.

    In closed form; None for any other motion.
    """
    spec, path = motion.spec, motion.trajectory
    model = spec.model
    if not (isinstance(model, Rigid) and model.restitution == 0.0 and len(path.takeoff) > 1):
        return None
    spans, flight_time = np.diff(path.takeoff), path.flight_time[-1]
    periods = round(float(spans[-1]) / (2.0 * np.pi))
    if periods < 1 or np.abs(spans - 2.0 * np.pi * periods).max() > SETTLED:
        return None
    try:
        cycle = branch(spec.omega, spec.xi, periods, np.array([flight_time]))
        if abs(float(cycle.gamma[0]) - spec.gamma) > SETTLED * spec.gamma:
            return None
        return energy(spec.omega, spec.xi, periods, np.array([flight_time]))
    except KernelInputError:
        return None


def of_cell(
    sweep: Sweep,
    values: Mapping[str, float | None],
    direction: str | None,
    periods: int,
    samples: int,
) -> tuple[TrajectorySpec, NDArray[np.float64] | None]:
    """The trajectory of the grid cell nearest to `values`, and the state a ramp left the cell in.

    None for a sweep from rest, whose cells settle as they did in the sweep. Raises InvalidRequest as
    `diagram.diagram`, and for a cell of a ramp that is not computed yet, or that is unresolved or diverged:
    its stored state is where the computation stopped, not the end of its window. Raises OutdatedJob for a
    sweep of another kernel version.
    """
    check_kernel(sweep.kernel_version)
    spec = sweep.spec
    cell = {axis: nearest_index(spec, axis, values.get(axis)) for axis in AXES}
    direction = resolve_direction(spec, direction)
    state = None
    if spec.ramp_axis is not None:
        state = _end_state(sweep, direction, {axis: point.index for axis, point in cell.items()})
    trajectory = TrajectorySpec(
        **{axis: point.value for axis, point in cell.items()},
        model=spec.model,
        settle=min(spec.settle, MAX_SETTLE) if state is None else 0,
        periods=periods,
        samples=samples,
    )
    return trajectory, state


def of_attractor(
    job: Stored[BasinSpec] | Stored[MultistabilitySpec],
    values: Mapping[str, float | None],
    attractor: int,
    periods: int,
    samples: int,
) -> tuple[TrajectorySpec, NDArray[np.float64]]:
    """The trajectory on an attractor of the grid cell nearest to `values`, and its stored state.

    attractor: its place in the cell, from 1. Raises InvalidRequest as `selection.nearest_index`, and for an
    attractor that is not stored. Raises OutdatedJob for a job of another kernel version.
    """
    check_kernel(job.kernel_version)
    spec = job.spec
    cell = {axis: nearest_index(spec, axis, values.get(axis)) for axis in AXES}
    indices = {axis: point.index for axis, point in cell.items()}
    names = ("attractor_outcome", "attractor_state")
    arrays = read_stored(job, names, indices, lambda: {"attractor_outcome": np.zeros(0)})
    stored = int(np.count_nonzero(arrays["attractor_outcome"] != Outcome.MISSING))
    if not 1 <= attractor <= stored:
        rule = (
            f"must be from 1 to {stored}: the attractors of this cell" if stored else "this cell has none yet"
        )
        raise InvalidRequest.of("attractor", rule)
    trajectory = TrajectorySpec(
        **{axis: point.value for axis, point in cell.items()},
        model=spec.model, settle=0, periods=periods, samples=samples,
    )  # fmt: skip
    return trajectory, np.asarray(arrays["attractor_state"][attractor - 1])


def _on_cycle(cell: Cell, point: CyclePoint) -> CycleStart:
    """The start on a cycle. Raises InvalidRequest."""
    periods, time = point.periods, point.flight_time
    try:
        found = start_on_stable_cycle(cell, periods) if time is None else start_on_cycle(cell, periods, time)
    except KernelInputError as error:
        raise InvalidRequest.of(error.argument, error.rule) from error
    if found is None:
        at = f"gamma {cell.gamma:g}, omega {cell.omega:g}, xi {cell.xi:g}"
        rule = f"there is no cycle (1, {periods}) at {at}" if time is not None else no_cycle(cell, periods)
        raise InvalidRequest.of("start", rule)
    return found


def _settled(
    sweep: SweepSpec, gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64]
) -> NDArray[np.float64]:
    line = run_cells(sweep, gamma, omega, xi, None)
    _check_ended("settle", line.outcome[0])
    return np.asarray(line.end_state[0])


def _check_ended(field: str, outcome: int) -> None:
    """Raise InvalidRequest unless the cell's window ended where its samples are to begin."""
    if outcome in (Outcome.DIVERGED, Outcome.UNRESOLVED):
        name = Outcome(outcome).name.lower()
        raise InvalidRequest.of(field, f"the cell is {name} before the first sample")


def _end_state(sweep: Sweep, direction: str, indices: dict[str, int]) -> NDArray[np.float64]:
    names = (schema.OUTCOME.name, schema.END_STATE.name)
    arrays = read(sweep, names, direction, indices)
    if arrays[schema.OUTCOME.name] == Outcome.MISSING:
        raise InvalidRequest.of("gamma", "this cell is not computed yet; a ramp computes its cells in order")
    _check_ended("gamma", int(arrays[schema.OUTCOME.name]))
    return np.asarray(arrays[schema.END_STATE.name])
