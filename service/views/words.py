"""Branches of words: of the cycles, of any number of bounces, that cells of a sweep settled to."""

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
import xarray
from pydantic import Field

from kernel.branches.energy import word_energy
from kernel.branches.events import join_events
from service.results.selection import GridValue, Stored, check_metadata, nearest_index, resolve_direction
from service.views import branches
from service.views.branches import BALANCE, BRANCH, EVENTS, ROWS, columns, event_columns, padded
from service.views.variables import coordinate, variable
from service.views.view import Call, Estimate, Number, Query, View
from worker import store
from worker.analysis.words import MAX_WORDS, POINTS, Skipped, Words, continue_words
from worker.spec import SweepSpec

#: Bytes of an answer.
_MEMORY: Final = 16 * 2**20
#: Of a line without a computed cell.
_NONE: Final = Words((), (), ())

_POINT: Final = ("gamma", "multipliers", "stable", "admissible")
_FLIGHT: Final = ("flight_time", "takeoff_phase", "impact_velocity")


class WordsQuery(Query):
    """The spring of the sweep nearest to the given values, and the direction whose cells are continued."""

    omega: Number | None = None
    xi: Number | None = None
    direction: Annotated[
        str | None, Field(description="rest, up or down; default: the first direction of the sweep")
    ] = None
    gamma_max: branches.GammaMax = 8.0
    energy: branches.WithEnergy = False


def _line(spec: SweepSpec, query: WordsQuery) -> tuple[str, dict[str, GridValue]]:
    """Direction and spring of the cells. Raises InvalidRequest."""
    spring = {axis: nearest_index(spec, axis, getattr(query, axis)) for axis in ("omega", "xi")}
    return resolve_direction(spec, query.direction), spring


def parts(study: Stored[SweepSpec], query: WordsQuery) -> Sequence[Call]:
    """The branches of one line, unless nothing is stored yet."""
    try:
        check_metadata(study)
    except store.StoreMissing as error:
        if study.complete:
            raise store.StoreDamaged(str(error)) from error
        return []
    direction, spring = _line(study.spec, query)
    indices = (study.spec.directions.index(direction), spring["xi"].index, spring["omega"].index)
    return [(continue_words, study.spec, study.url, *indices, query.gamma_max, study.complete)]


def compute(study: Stored[SweepSpec], query: WordsQuery, found: Words = _NONE) -> xarray.Dataset:
    """Branches of the cycles that cells along Γ settled to.

    Stable and unstable ones, with their events, of the rigid contact without restitution: cells of another
    contact are a guess from which its cycles are looked for. A worker follows a branch in some tenths of a
    second. `skipped` are the periodic cells from which no branch was followed.
    """
    direction, spring = _line(study.spec, query)
    data = padded(_POINT, found.branches) | padded(_FLIGHT, found.branches, ("branch", "point", "flight"))
    if query.energy:
        data |= padded(BALANCE, [word_energy(branch) for branch in found.branches])
    data |= event_columns(join_events(found.events))
    on = np.repeat(np.arange(len(found.events)), [len(events.gamma) for events in found.events])
    data |= columns("event", {"branch": on})
    data |= columns("skipped", {name: [getattr(x, name) for x in found.skipped] for name in Skipped._fields})
    coords = branches.of_branches(found.branches)
    coords |= {"word": variable((), [branch.word for branch in found.branches], ROWS["word"])}
    coords |= {axis: coordinate(axis, at.value) for axis, at in spring.items()}
    coords |= {"direction": coordinate("direction", direction)}
    return branches.dataset(data, coords, study.complete, gamma_max=query.gamma_max)


def estimate(spec: SweepSpec, query: WordsQuery) -> Estimate:
    """The points of as many branches as are followed. Raises InvalidRequest for a line that is not there."""
    _line(spec, query)
    sizes = {"branch": MAX_WORDS, "point": 2 * POINTS, "multiplier": 2, "part": 2}
    return Estimate(sizes, memory=_MEMORY, small=False)


VIEW: Final = View(
    "orbits", "Branches of a sweep's cycles", SweepSpec, WordsQuery, compute, estimate,
    variables=(
        *(ROWS[name] for name in (*_POINT, *_FLIGHT, *BALANCE, *BRANCH, "word")),
        *EVENTS, ROWS["event_branch"], *(ROWS[f"skipped_{name}"] for name in Skipped._fields),
    ),
    rows="flight_time", printed=("event_gamma", "skipped_gamma"), parts=parts,
)  # fmt: skip
