"""One cell, computed while the caller waits: where the masses and the plate are, phase by phase."""

import json
from dataclasses import dataclass
from typing import Annotated, Any, Final, Self

import numpy as np
from fastapi import APIRouter, Response
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from kernel.modes import TWO_PI
from kernel.params import Cell, Outcome
from kernel.trajectory import Trajectory, sample
from service.api import schemas
from service.api.dependencies import JsonBody, TheService
from service.api.schemas import problem_responses
from service.errors import InvalidRequest, TooLarge
from worker.cost import cell_seconds
from worker.spec import LARGEST, SMALLEST, SweepSpec, parsing
from worker.spec.axes import NUMBER, WHOLE, Strict
from worker.spec.contact_models import (
    Contact,
    Soft,
    model_fields,
    penetration_of,
)
from worker.spec.errors import Problem, SpecInvalid, describe, problems_of
from worker.tasks import plate_of, run_cells

router = APIRouter(prefix="/v1")

#: Samples in one answer.
MAX_SAMPLES: Final = 20_000

#: The paper takes contacts 1e-4 rest lengths deep.
DEPTH_OVER_LENGTH: Final = 1e-4


class TrajectorySpec(Strict):
    """One cell and how closely to look at it; what is left out is as in a sweep."""

    gamma: Annotated[float, Field(ge=SMALLEST, le=LARGEST), NUMBER]
    omega: Annotated[float, Field(ge=SMALLEST, le=LARGEST), NUMBER]
    xi: Annotated[float, Field(ge=0.0, le=LARGEST), NUMBER]
    model: Contact = Soft()
    settle: Annotated[int, Field(ge=0, le=1_000_000), WHOLE] = 200
    periods: Annotated[int, Field(ge=1, le=MAX_SAMPLES), WHOLE] = 4
    samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES), WHOLE] = 200

    def __init__(self, /, **data: object) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise SpecInvalid(problems_of(error, _fields())) from None

    @classmethod
    def from_json(cls, text: bytes) -> Self:
        """From JSON text. Raises SpecUnreadable or SpecInvalid."""
        data = parsing.read_json(text)
        if not isinstance(data, dict):
            raise SpecInvalid([Problem("", f"a trajectory must be an object, not {describe(data)}")])
        odd = [name for name in data if not name.isprintable()]
        if odd:
            raise SpecInvalid([Problem("", f"field names must be printable text, not {describe(odd[0])}")])
        return cls(**data)

    def sweep(self) -> SweepSpec:
        """The sweep of this one cell, of what comes before the samples; raises SpecInvalid as it does."""
        return SweepSpec(
            gamma=self.gamma, omega=self.omega, xi=self.xi, model=self.model,
            settle=max(self.settle - 1, 0), observe=1, keep=1,
        )  # fmt: skip


def _fields() -> dict[str, tuple[str, ...]]:
    return {"": tuple(TrajectorySpec.model_fields), **model_fields()}


@dataclass(frozen=True)
class Found:
    """A trajectory and how long the spring is drawn, in plate amplitudes."""

    spec: TrajectorySpec
    trajectory: Trajectory
    rest_length: float


@router.post(
    "/trajectories",
    response_model=schemas.Trajectory,
    responses=problem_responses(400, 408, 413, 415, 422, 429),
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TrajectorySpec"}}},
        }
    },
)
def trajectory(service: TheService, body: JsonBody) -> Response:
    """One cell from rest, after `settle` plate periods: plate, masses and contact force, sample by sample.

    Lengths are in plate amplitudes: the paper's zω²/g divided by Γ, as its Fig. 2 draws them.
    """
    spec = TrajectorySpec.from_json(body)
    sweep = spec.sweep()
    check_cost(spec, sweep, service.settings.trajectory_seconds)
    with service.trajectories.turn():
        found = compute(spec, sweep)
    return Response(as_json(found), media_type="application/json")


def check_cost(spec: TrajectorySpec, sweep: SweepSpec, seconds: float) -> None:
    """Raise TooLarge for more samples or computing than one answer may take."""
    asked = spec.periods * spec.samples + 1
    if asked > MAX_SAMPLES:
        raise TooLarge(
            f"periods × samples: asks for {asked:,} samples, at most {MAX_SAMPLES:,} are sent; "
            f"{max((MAX_SAMPLES - 1) // spec.periods, 1):,} samples a period would do"
        )
    periods = spec.settle + spec.periods
    takes = cell_seconds(sweep) / (sweep.settle + sweep.observe) * periods
    if takes > seconds:
        fit = int(periods * seconds / takes)
        raise TooLarge(
            f"settle: {periods:,} periods of this contact take some {takes:.3g} s, at most {seconds:g} s are "
            f"spent on one answer; submit it as a sweep, or settle for {fit:,} periods"
        )


def compute(spec: TrajectorySpec, sweep: SweepSpec, state: NDArray[np.float64] | None = None) -> Found:
    """The trajectory of one cell, settled from rest, or on from a state in the cell's own units."""
    gamma, omega, xi = (np.array([value]) for value in (spec.gamma, spec.omega, spec.xi))
    depth = penetration_of(spec.model, gamma, omega)
    if state is None and spec.settle:
        state = _settled(sweep, gamma, omega, xi)
    found = sample(
        Cell(spec.gamma, spec.omega, spec.xi),
        plate_of(spec.model, gamma, omega, xi),
        state,
        periods=spec.periods,
        samples=spec.samples,
    )
    return Found(spec, found, float(depth[0]) / DEPTH_OVER_LENGTH)


def _settled(
    sweep: SweepSpec, gamma: NDArray[np.float64], omega: NDArray[np.float64], xi: NDArray[np.float64]
) -> NDArray[np.float64]:
    line = run_cells(sweep, gamma, omega, xi, None)
    if line.outcome[0] in (Outcome.DIVERGED, Outcome.UNRESOLVED):
        name = Outcome(line.outcome[0]).name.lower()
        raise InvalidRequest.of("settle", f"the cell is {name} before that: there is nothing to show")
    return np.asarray(line.end_state[0])


def as_json(found: Found) -> bytes:
    """The trajectory as a JSON document; null beyond where it could be followed."""
    path, spec = found.trajectory, found.spec
    lower = path.plate + path.gap
    return json.dumps(
        {
            "gamma": spec.gamma,
            "omega": spec.omega,
            "xi": spec.xi,
            "model": spec.model.model_dump(),
            "rest_length": found.rest_length,
            "phase": path.phase.tolist(),
            "plate": path.plate.tolist(),
            "z1": _numbers(lower + found.rest_length + path.elongation),
            "z2": _numbers(lower),
            "force": _numbers(path.force),
            "in_flight": path.in_flight.tolist(),
            "flights": {
                "takeoff": path.takeoff.tolist(),
                "takeoff_phase": (path.takeoff % TWO_PI).tolist(),
                "flight_time": path.flight_time.tolist(),
            },
            "complete": path.complete,
        },
        allow_nan=False,
        separators=(",", ":"),
    ).encode()


def _numbers(values: NDArray[np.float64]) -> list[Any]:
    return [value if np.isfinite(value) else None for value in values.tolist()]
