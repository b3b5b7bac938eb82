"""Branches of cycles of one bounce at one spring, in closed form."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Final

import xarray
from pydantic import Field

from kernel.branches.energy import energy
from kernel.branches.events import Branch, Events, branch_and_events, join_events
from service.views import branches
from service.views.branches import BALANCE, BRANCH, EVENTS, ROWS, event_columns, padded, parse_modes
from service.views.variables import coordinate
from service.views.view import AT_ONCE_SECONDS, Call, Estimate, Omega, Query, View, Xi
from worker.analysis.prediction import branch_seconds
from worker.orbits import MAX_POINTS

#: Branches kept in a process, those requested last.
KEPT: Final = 64

#: Bytes of a point of a branch, with what is computed on the way to it.
_PER_POINT: Final = 4_000

_POINT: Final = (
    "gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity", "impact_velocity",
    "multipliers", "stable", "admissible",
)  # fmt: skip


class OrbitsQuery(Query):
    """A spring, and which of its branches to compute."""

    omega: Omega
    xi: Xi
    modes: branches.Modes = "1-1,1-2"
    gamma_max: branches.GammaMax = 8.0
    points: Annotated[int, Field(ge=10, le=MAX_POINTS, description="of each branch, at least")] = 400
    energy: branches.WithEnergy = False


def parts(study: None, query: OrbitsQuery) -> Sequence[Call]:
    """The branch of each mode, if they take longer than AT_ONCE_SECONDS together."""
    grids = _grids(query)
    quick = sum(branch_seconds(*grid) for grid in grids) <= AT_ONCE_SECONDS
    return [] if quick else [(branch_and_events, *grid) for grid in grids]


def _grids(query: OrbitsQuery) -> list[tuple[float, float, int, int]]:
    """Spring, plate periods and points of each branch."""
    return [(query.omega, query.xi, mode.periods, query.points) for mode in parse_modes(query.modes)]


def compute(study: None, query: OrbitsQuery, *found: tuple[Branch, Events]) -> xarray.Dataset:
    """Branches of cycles of one bounce, and their events.

    Stable and unstable ones, in closed form, of the rigid contact without restitution. A branch that leaves
    `gamma_max` and comes back is several pieces.
    """
    found = found or tuple(_branch(*grid) for grid in _grids(query))
    pieces = [piece for branch, _ in found for piece in branches.below(branch, query.gamma_max)]
    data = padded(_POINT, pieces)
    if query.energy:
        data |= padded(BALANCE, [energy(x.omega, x.xi, x.periods, x.flight_time) for x in pieces])
    data |= event_columns(join_events([branches.rows_of(e, e.gamma <= query.gamma_max) for _, e in found]))
    coords = branches.of_branches(pieces)
    coords |= {name: coordinate(name, getattr(query, name)) for name in ("omega", "xi")}
    return branches.dataset(data, coords, gamma_max=query.gamma_max)


_branch = lru_cache(KEPT)(branch_and_events)


def estimate(spec: None, query: OrbitsQuery) -> Estimate:
    """All points of the branches. Raises InvalidRequest for a branch that is too long, or not there."""
    lengths = [branches.grid_length(*grid) for grid in _grids(query)]
    sizes = {"branch": len(lengths), "point": max(lengths), "multiplier": 2, "part": 2}
    return Estimate(sizes, memory=sum(lengths) * _PER_POINT)


VIEW: Final = View(
    "orbits", "Branches of a spring", None, OrbitsQuery, compute, estimate,
    variables=tuple(ROWS[name] for name in (*_POINT, *BALANCE, *BRANCH)) + EVENTS,
    rows="gamma", printed=("event_gamma",), parts=parts,
)  # fmt: skip
