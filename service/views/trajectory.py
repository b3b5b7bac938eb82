"""The motion of one cell while the caller waits: plate, masses and contact force, sample by sample."""

from typing import Annotated, Any, ClassVar, Final, Literal, Self

import numpy as np
import xarray
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from kernel.cycles.energy import energy
from kernel.cycles.events import Branch, branch
from kernel.cycles.starts import start_on_cycle, start_on_stable_cycle
from kernel.numerics.elementary import TWO_PI
from kernel.params import STATE_FIELDS, Cell, KernelInputError, Outcome
from kernel.trajectory import Trajectory, sample
from service.errors import InvalidRequest, TooLarge
from service.pictures import LINES, Figure
from service.views import proofs, selection
from service.views.variables import ENERGY, coordinate, dataset, row, variables
from service.views.view import Estimate, FirstDirection, Number, Query, View
from worker.analysis.cycles import own_cycle
from worker.basins.specification import MAX_HEIGHT, BasinSpec, MultistabilitySpec
from worker.basins.starts import contact_states, drop_states
from worker.spec.axes import LARGEST, NUMBER, SMALLEST, WHOLE, Strict, check_kind, kind_of
from worker.spec.contact_models import Contact, Rigid, Soft, penetration_of
from worker.spec.errors import BrokenRuleError, one_of
from worker.spec.specification import Document
from worker.sweep import AXES, SweepSpec, schema
from worker.sweep.plan import period_seconds
from worker.sweep.protocols import MAX_START_PERIODS, OnCycle
from worker.sweep.specification import WITH_CYCLES, no_cycle
from worker.sweep.task import run_cells
from worker.work import plate_of

#: Limit on the samples in an answer.
MAX_SAMPLES: Final = 20_000
#: Bytes of memory for a sample, with its numbers as text.
BYTES_PER_SAMPLE: Final = 1_000

#: A motion is a cycle if its take-offs are whole periods apart within this, rad.
SETTLED: Final = 1e-6

#: Limit on the plate periods before the first sample.
MAX_SETTLE: Final = 1_000_000

#: Contact depth over the rest length: without a rest length the spring is 1e4 contact depths long, as in the
#: paper.
DEPTH_OVER_LENGTH: Final = 1e-4

#: Limit on the flight times of cycles, rad.
_LONGEST: Final = 2.0 * np.pi * MAX_START_PERIODS


def _state(value: object) -> object:
    if not isinstance(value, list | tuple) or len(value) != len(STATE_FIELDS):
        raise BrokenRuleError("", f"must be a list of {len(STATE_FIELDS)} numbers: {', '.join(STATE_FIELDS)}")
    return tuple(value)


class CyclePoint(OnCycle):
    """A cycle to start on.

    `flight_time`, rad: of the cell's cycles the one whose flight takes nearest to it, unstable ones too; of a
    soft contact or one with restitution, its own. Null: the stable one of the closed form with the longest
    flight. `state`: a `cycle_state` of `orbits`, of any bounces; `flight_time` decides if it is on no cycle.
    """

    kind: Literal["cycle"] = "cycle"
    flight_time: Annotated[float, Field(gt=0.0, lt=_LONGEST), NUMBER] | None = None
    state: (
        Annotated[
            tuple[Annotated[float, Field(ge=-MAX_HEIGHT, le=MAX_HEIGHT), NUMBER], ...],
            BeforeValidator(_state),
        ]
        | None
    ) = None


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


class TrajectorySpec(Document):
    """One cell, the plate periods before and during the samples, and the samples per period.

    With a `start` the samples begin on a cycle, with a drop or in contact, and `settle` is 0.
    """

    WHAT: ClassVar = "a trajectory"

    gamma: Annotated[float, Field(ge=SMALLEST, le=LARGEST), NUMBER]
    omega: Annotated[float, Field(ge=SMALLEST, le=LARGEST), NUMBER]
    xi: Annotated[float, Field(ge=0.0, le=LARGEST), NUMBER]
    model: Contact = Soft()
    settle: Annotated[int, Field(ge=0, le=MAX_SETTLE), WHOLE] = 200
    periods: Annotated[int, Field(ge=1, le=MAX_SAMPLES), WHOLE] = 4
    samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES), WHOLE] = 200
    start: (
        Annotated[
            Annotated[CyclePoint, Tag(CyclePoint.tag())]
            | Annotated[DropStart, Tag(DropStart.tag())]
            | Annotated[ContactStart, Tag(ContactStart.tag())],
            Discriminator(lambda value: _STARTS[kind_of(value, "cycle")].tag()),
            BeforeValidator(lambda value: check_kind(value, _STARTS, _STARTS, "cycle")),
        ]
        | None
    ) = None
    prove: Annotated[bool, Field(strict=True)] = False

    def __init__(self, /, **data: object) -> None:
        if data.get("start") is not None:
            data = {"settle": 0} | data
        super().__init__(**data)

    @model_validator(mode="after")
    def _starts_elsewhere_than_at_rest(self) -> Self:
        if self.start is None:
            return self
        if self.settle:
            start = "a start on a cycle" if self.start.kind == "cycle" else "a start"
            raise BrokenRuleError("settle", f"must be 0 with {start}, not {self.settle}")
        if self.start.kind != "drop" and self.model.kind not in WITH_CYCLES:
            rule = f"needs a spring, and model.kind is {self.model.kind!r}; {one_of(WITH_CYCLES)} works"
            raise BrokenRuleError("start", rule)
        return self

    def sweep(self) -> SweepSpec:
        """The sweep of this cell that ends where the samples begin. Raises SpecInvalid."""
        return SweepSpec(
            gamma=self.gamma, omega=self.omega, xi=self.xi, model=self.model,
            settle=max(self.settle - 1, 0), observe=1, keep=1,
        )  # fmt: skip


_LENGTH: Final = "plate amplitudes"

#: The variables. Those of a cycle belong to a start on one; the energies to a cycle of one bounce on a rigid
#: plate without restitution.
_ROWS: Final = (
    row("plate", ("phase",), "<f8", "plate", _LENGTH),
    row("z1", ("phase",), "<f8", "upper mass", _LENGTH),
    row("z2", ("phase",), "<f8", "lower mass", _LENGTH),
    row("velocity", ("phase",), "<f8", "velocity of the spring's elongation", "A omega"),
    row("force", ("phase",), "<f8", "force of the plate on the lower mass", "m A ω²"),
    row("in_flight", ("phase",), "?", "whether the spring is off the plate"),
    row("takeoff", ("flight",), "<f8", "phase of the plate at take-off, as `phase`", "rad"),
    row("takeoff_phase", ("flight",), "<f8", "plate phase at take-off, modulo 2 pi", "rad"),
    row("flight_time", ("flight",), "<f8", "flight time", "rad"),
    row("cycle_bounces", (), "<i4", "bounces of the cycle"),
    row("cycle_periods", (), "<i4", "plate periods of the cycle"),
    row("cycle_flight_time", (), "<f8", "flight time of the cycle", "rad"),
    row("cycle_multipliers", ("multiplier", "part"), "<f8", "Floquet multipliers, real and imaginary"),
    row("cycle_stable", (), "?", "whether both multipliers are inside the unit circle"),
    row("cycle_violations", (), "|u1", "0, or the sum of the conditions that fail"),
    *(array._replace(name=f"energy_{array.name}") for array in ENERGY),
    *proofs.OF_CELL,
)


def _seconds(spec: TrajectorySpec) -> float:
    """Estimated seconds of computing. Raises SpecInvalid as `sweep`, TooLarge for too many samples."""
    sweep = spec.sweep()
    samples = spec.periods * spec.samples + 1
    if samples > MAX_SAMPLES:
        raise TooLarge(
            f"periods × samples: {samples:,} samples; the limit is {MAX_SAMPLES:,}, "
            f"{max((MAX_SAMPLES - 1) // spec.periods, 1):,} per period"
        )
    return period_seconds(sweep, alone=True) * (spec.settle + spec.periods)


def check_cost(spec: TrajectorySpec, max_seconds: float) -> None:
    """Raise TooLarge for more samples or more computing than one answer may take, SpecInvalid as `sweep`."""
    seconds, periods = _seconds(spec), spec.settle + spec.periods
    if seconds > max_seconds:
        fitting = int(periods * max_seconds / seconds)
        raise TooLarge(
            f"settle: {periods:,} periods of this contact take about {seconds:.3g} s; the limit for one "
            f"answer is {max_seconds:g} s: submit a sweep, or settle for {fitting:,} periods"
        )


def motion(spec: TrajectorySpec, state: NDArray[np.float64] | None = None) -> xarray.Dataset:
    """The motion of a cell: after `settle` periods from rest, from its start, or from a state (6,).

    state: in the cell's units, as STATE_FIELDS. Raises InvalidRequest if the cell does not settle, or has no
    such cycle; NotInstalled for a proof without its library.
    """
    cell = Cell(spec.gamma, spec.omega, spec.xi)
    gamma, omega, xi = (np.array([value]) for value in cell)
    values: dict[str, Any] = {}
    if isinstance(spec.start, CyclePoint):
        cycle, state = _on_cycle(spec.model, cell, spec.start)
        values = {
            "cycle_bounces": cycle.bounces[0], "cycle_periods": cycle.periods,
            "cycle_flight_time": cycle.flight_time[0], "cycle_stable": cycle.stable[0],
            "cycle_multipliers": [[mu.real, mu.imag] for mu in cycle.multiplier[0]],
            "cycle_violations": cycle.violations[0],
        }  # fmt: skip
    elif isinstance(spec.start, DropStart):
        state = drop_states(np.array(spec.start.height), np.array(spec.start.phase))
    elif isinstance(spec.start, ContactStart):
        elongation, velocity = np.array(spec.start.elongation), np.array(spec.start.velocity)
        state = contact_states(spec.model, (spec.gamma, spec.omega, spec.xi), elongation, velocity)
    if state is None and spec.settle:
        line = run_cells(spec.sweep(), (gamma, omega, xi), None)
        _check_ended("settle", line.outcome[0])
        state = line.end_state[0]
    plate = plate_of(spec.model, gamma, omega, xi)
    path = sample(cell, plate, state, periods=spec.periods, samples=spec.samples)
    if spec.prove:
        values |= proofs.of_cell(spec.model, cell, state)
    length = float(penetration_of(spec.model, gamma, omega)[0]) / DEPTH_OVER_LENGTH
    z2 = path.plate + path.gap
    values |= {
        "plate": path.plate, "z1": z2 + length + path.elongation, "z2": z2, "velocity": path.velocity,
        "force": path.force,
        "in_flight": path.in_flight, "takeoff": path.takeoff, "takeoff_phase": path.takeoff % TWO_PI,
        "flight_time": path.flight_time, **_energies(spec, path),
    }  # fmt: skip
    coords = {axis: coordinate(axis, getattr(spec, axis)) for axis in AXES}
    about = {"long_name": "plate phase, with whole periods added", "units": "rad"}
    return dataset(
        variables(_ROWS, values),
        {"phase": coordinate("phase", path.phase, **about), **coords},
        {"rest_length": length, "model": spec.model.kind, "complete": path.complete},
    )


def _energies(spec: TrajectorySpec, path: Trajectory) -> dict[str, float]:
    """The energy balance in closed form, if the samples show a cycle to which it applies; else empty.

    It applies to cycles of one bounce on a rigid plate without restitution.
    """
    model = spec.model
    if not (isinstance(model, Rigid) and model.restitution == 0.0 and len(path.takeoff) > 1):
        return {}
    spans, flight_time = np.diff(path.takeoff), path.flight_time[-1]
    periods = round(float(spans[-1]) / TWO_PI)
    if periods < 1 or np.abs(spans - TWO_PI * periods).max() > SETTLED:
        return {}
    try:
        cycle = branch(spec.omega, spec.xi, periods, np.array([flight_time]))
        if abs(float(cycle.gamma[0]) - spec.gamma) > SETTLED * spec.gamma:
            return {}
        balance = energy(spec.omega, spec.xi, periods, np.array([flight_time]))
    except KernelInputError:
        return {}
    return {f"energy_{name}": x[0] for name, x in balance._asdict().items()}


class TrajectoryQuery(Query):
    """The cell of the job nearest to the given values, and how to sample its motion."""

    gamma: Number | None = None
    omega: Number | None = None
    xi: Number | None = None
    direction: FirstDirection = None
    attractor: int | None = Field(
        None, ge=1, description="of a job of basins or multistability: which attractor of the cell, from 1"
    )
    periods: Annotated[int, Field(ge=1, le=1000, description="plate periods")] = 4
    samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES, description="per plate period")] = 200
    prove: Annotated[bool, Field(description="the cycle that the cell is on, with a proof")] = False


_Spec = SweepSpec | BasinSpec | MultistabilitySpec


def compute(study: selection.Stored[_Spec], query: TrajectoryQuery) -> xarray.Dataset:
    """The motion of one cell of a job.

    The samples begin after it has settled from rest, on its certified cycle, where the ramp left it, or on
    one of its attractors. Lengths are in plate amplitudes; the attribute `rest_length` is that of the spring.
    Flights are those that start and end within the samples. Refused for a cell of a ramp that is not
    computed yet, or that is unresolved or diverged: its stored state is where the computation stopped.
    """
    selection.check_kernel(study)
    return motion(_cell(study.spec, query), _start(study, query))


def estimate(spec: _Spec, query: TrajectoryQuery) -> Estimate:
    """All samples. Raises InvalidRequest for a cell that the job lacks, or without `attractor`; TooLarge."""
    cell = _cell(spec, query)
    seconds, samples = _seconds(cell), cell.periods * cell.samples + 1
    return Estimate({"phase": samples}, memory=samples * BYTES_PER_SAMPLE, seconds=seconds, small=False)


def _cell(spec: _Spec, query: TrajectoryQuery) -> TrajectorySpec:
    """The nearest cell of the grid, and its samples. Only a cell of a sweep from rest settles again."""
    values = {axis: nearest.value for axis, nearest in selection.nearest_values(spec, query, AXES).items()}
    settle = 0
    if not isinstance(spec, SweepSpec):
        if query.attractor is None:
            raise InvalidRequest.of("attractor", f"is required: the protocol is {spec.protocol.kind}")
    elif query.attractor is not None:
        raise InvalidRequest.of("attractor", "must be left out: the job is a sweep, which stores none")
    else:
        _direction(spec, query)
        settle = min(spec.window[0], MAX_SETTLE) if spec.ramp_axis is None else 0
    sampling = query.model_dump(include={"periods", "samples", "prove"})
    return TrajectorySpec(**values, model=spec.model, settle=settle, **sampling)


def _start(study: selection.Stored[_Spec], query: TrajectoryQuery) -> NDArray[np.float64] | None:
    """The state of the attractor, or at the end of a ramp's cell or a certified one; else None, for rest."""
    spec = study.spec
    nearest = selection.nearest_values(spec, query, AXES)
    indices = {axis: grid.index for axis, grid in nearest.items()}
    if query.attractor is not None:
        arrays = selection.read_stored(study, ("attractor_outcome", "attractor_state"), indices)
        stored = int(np.count_nonzero(arrays["attractor_outcome"] != Outcome.MISSING))
        if query.attractor > stored:
            rule = f"must be from 1 to {stored}: the attractors of this cell"
            raise InvalidRequest.of("attractor", rule if stored else "this cell has none yet")
        return np.asarray(arrays["attractor_state"][query.attractor - 1])
    if not isinstance(spec, SweepSpec) or not (spec.ramp_axis or spec.certifies):
        return None
    indices["direction"] = _direction(spec, query)
    if spec.ramp_axis is None:
        if np.isnan(selection.read_stored(study, ("flight_error",), indices)["flight_error"]):
            return None
        # near a bifurcation its motion takes longer than `settle` to the cycle: end there as the sweep did
        cells = [np.array([nearest[axis].value]) for axis in Cell._fields]
        return np.asarray(run_cells(spec, cells, None).end_state[0])
    names = (schema.OUTCOME.name, schema.END_STATE.name)
    arrays = selection.read_stored(study, names, indices)
    if arrays[schema.OUTCOME.name] == Outcome.MISSING:
        raise InvalidRequest.of("gamma", "this cell is not computed yet; a ramp computes its cells in order")
    _check_ended("gamma", int(arrays[schema.OUTCOME.name]))
    return np.asarray(arrays[schema.END_STATE.name])


def _direction(spec: SweepSpec, query: TrajectoryQuery) -> int:
    return spec.directions.index(selection.directions_of(spec, query.direction)[0])


def _on_cycle(model: Contact, cell: Cell, point: CyclePoint) -> tuple[Branch, NDArray[np.float64]]:
    """A cycle, and a state (6,) on it: the contact's own with a flight time, else in closed form.

    Raises InvalidRequest.
    """
    periods, time = point.periods, point.flight_time
    try:
        if isinstance(model := model.exact, Rigid | Soft):
            state = None if point.state is None else np.array(point.state)
            own = own_cycle(model, cell, periods, state, time if model.has_own_cycles else None)
            if own is not None:
                return own
        start = start_on_stable_cycle(cell, periods) if time is None else start_on_cycle(cell, periods, time)
    except KernelInputError as error:
        raise InvalidRequest.of(error.argument, error.rule) from error
    if start is None:
        where = f"gamma {cell.gamma:g}, omega {cell.omega:g}, xi {cell.xi:g}"
        rule = f"there is no cycle (1, {periods}) at {where}" if time is not None else no_cycle(cell, periods)
        raise InvalidRequest.of("start", rule)
    return start.cycle, start.start.state


def _check_ended(field: str, outcome: int) -> None:
    """Raise InvalidRequest if the cell diverged or stayed unresolved before the first sample."""
    if outcome in (Outcome.DIVERGED, Outcome.UNRESOLVED):
        name = Outcome(outcome).name.lower()
        raise InvalidRequest.of(field, f"the cell is {name} before the first sample")


def draw(result: xarray.Dataset, figure: Figure) -> None:
    """Draw plate and masses, the upper mass lowered by the rest length, and the contact force."""
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    periods = result.phase.values / TWO_PI
    upper = result.z1.values - result.attrs["rest_length"]
    above.plot(periods, upper, color=LINES["upper-mass"], label="upper mass − rest length")
    above.plot(periods, result.z2.values, color=LINES["lower-mass"], label="lower mass")
    above.plot(periods, result.plate.values, color="black", label="plate")
    above.set_ylabel("height (plate amplitudes)")
    above.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    below.plot(periods, result.force.values, color="black")
    below.set(xlabel="plate periods", ylabel=r"force ($mA\omega^2$)")


VIEW: Final = View(
    "trajectory", "Motion of a cell", _Spec, TrajectoryQuery, compute, estimate,
    variables=_ROWS, rows="plate", activity="trajectory", draw=draw,
)  # fmt: skip
