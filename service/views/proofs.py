"""Proofs of a spring's threshold, of its events, and of a cell's cycle. Need the extra `proofs`."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.cell import SHORTEST_FLIGHT
from kernel.cycles.events import Events, Kind
from kernel.cycles.folds import Fold
from kernel.params import Cell
from service.errors import NotInstalled
from service.views.variables import row
from worker.spec.contact_models import Rigid, Soft
from worker.work import plate_of

_MOST_PERIODS: Final = 12  # most plate periods of the cycle of a cell
_SAME: Final = 1e-9  # largest distance of a counted event from the computed one, rad
_NEAR: Final = 1e-2  # largest distance of a settled state's cycle from the round that begins with the state

OF_THRESHOLD: Final = (
    row("proof", (), "U", "proven, disproven, not proven or not covered"),
    row("proof_says", (), "U", "the statement, or why there is none"),
    row("down_at_most", (), "U", "proven upper bound of down, rounded up"),
    row("proven_flight_time", ("bound",), "U", "flight time at the fold lies between", "rad"),
)
OF_CELL: Final = (
    *OF_THRESHOLD[:2],
    row("proven_flight_times", ("cycle_flight", "bound"), "U", "each flight lies between", "rad"),
)


def of_threshold(omega: float, xi: float, fold: Fold | None) -> dict[str, Any]:
    """The variables OF_THRESHOLD, for the fold at which bouncing ends. Raises NotInstalled."""

    def prove() -> dict[str, Any]:
        from kernel.proofs import balls, branches

        if fold is None:
            raise balls.NotProvenError("bouncing does not end at a fold", "not covered")
        says, gamma, times = branches.prove_down(omega, xi, fold)
        says = f"{says}; omega = {omega!r} and xi = {xi!r} are these decimals"
        bounds = {"down_at_most": balls.bounds(gamma)[1], "proven_flight_time": balls.bounds(times[0])}
        return {"proof_says": says} | bounds

    return {"down_at_most": "", "proven_flight_time": ("", "")} | _decided(prove)


def of_events(events: Events) -> NDArray[np.bool_]:
    """For each event of a (1,k) branch, whether all of its kind were counted. Raises NotInstalled."""
    complete = np.zeros(len(events.kind), np.bool_)

    def count() -> dict[str, Any]:
        from kernel.proofs import balls, branches

        spring = (x[0].item() for x in (events.omega, events.xi, events.periods))
        counted = balls.first_proven(lambda: branches.Branch(*spring).zeros(kind))
        times = np.sort(events.flight_time[chosen])
        complete[chosen] = len(counted) == len(times) and all(abs(times - [*map(float, counted)]) < _SAME)
        return {}

    for kind in (Kind.FOLD, Kind.FLIP):
        chosen = events.kind == kind
        if chosen.any():
            _decided(count)
    return complete


def of_cell(model: object, cell: Cell, state: NDArray[np.float64] | None) -> dict[str, Any]:
    """The variables OF_CELL, for the cycle near a state (6,). Raises NotInstalled."""

    def prove() -> dict[str, Any]:
        from kernel.cycles.cycles import cycle_from
        from kernel.cycles.descent import cycle_of
        from kernel.proofs import balls, cycles

        if state is None:
            raise balls.NotProvenError("the motion begins at rest: settle first")
        if not isinstance(model, Rigid | Soft):
            raise balls.NotProvenError(f"the contact is {getattr(model, 'kind', model)}", "not covered")
        axes = [np.array([value]) for value in cell]
        law = {name: np.ravel(value)[0].item() for name, value in model.plate_arguments(*axes).items()}
        plate = plate_of(model, *axes)
        points = (cycle_from(plate, cell, n, state, _NEAR) for n in range(1, _MOST_PERIODS + 1))
        point = next(filter(None, points), None)
        if point is None:
            raise balls.NotProvenError(f"no cycle of up to {_MOST_PERIODS} plate periods is near")
        takes_off = point.begun((point.letters.find("S") + 1) % len(point.letters))
        says, _, times = cycles.prove_cycle(cycles.Law(**law), cell, cycle_of(takes_off))
        flights = [balls.bounds(t) for t in times if t > SHORTEST_FLIGHT]
        return {"proof_says": f"{says}; the numbers are decimals", "proven_flight_times": flights}

    return {"proven_flight_times": np.empty((0, 2), "U1")} | _decided(prove)


def _decided(prove: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The result of `prove` with the verdict. Raises NotInstalled without the library for proofs."""
    if find_spec("flint") is None:
        raise NotInstalled('proofs need the extra proofs: pip install -e ".[proofs]"')
    from kernel.proofs.balls import NotProvenError

    try:
        return {"proof": "proven"} | prove()
    except NotProvenError as error:
        return {"proof": error.verdict, "proof_says": str(error)}
