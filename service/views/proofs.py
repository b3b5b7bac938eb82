"""What is proven of a spring's threshold, of its events, and of a cell's cycle, with the extra `proofs`."""

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
from worker.spec.contact_models import Rigid, Soft, penetration_of
from worker.work import plate_of

#: Plate periods of the cycles that are looked for at a cell.
_MOST_PERIODS: Final = 12
#: Rad between a counted event and the same in doubles.
_SAME: Final = 1e-9

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
    """What is proven of the fold at which bouncing ends, Ω and ξ as decimals. Raises NotInstalled."""

    def prove() -> dict[str, Any]:
        from kernel.proofs import balls, branches

        if fold is None:
            raise balls.NotCoveredError("bouncing does not end at a fold")
        proof = branches.prove_down(repr(omega), repr(xi), fold)
        return {
            "proof_says": f"{proof.says}; omega = {omega!r} and xi = {xi!r} are these decimals",
            "down_at_most": balls.bounds(proof.gamma)[1],
            "proven_flight_time": balls.bounds(proof.flight_times[0]),
        }

    return {"down_at_most": "", "proven_flight_time": ("", "")} | _decided(prove)


def of_events(events: Events) -> NDArray[np.bool_]:
    """Of each event of a (1,k) branch, whether all of its kind were counted. Raises NotInstalled."""
    complete = np.zeros(len(events.kind), np.bool_)

    def count() -> dict[str, Any]:
        from kernel.proofs.branches import FLIPS, FOLDS, all_events

        for kind, which in ((Kind.FOLD, FOLDS), (Kind.FLIP, FLIPS)):
            chosen = events.kind == kind
            if chosen.any():
                omega, xi, periods = (x[0].item() for x in (events.omega, events.xi, events.periods))
                counted = all_events(which, repr(omega), repr(xi), periods)
                times = np.sort(events.flight_time[chosen])
                complete[chosen] = len(counted) == len(times) and all(
                    abs(ball - time) < _SAME for ball, time in zip(counted, times, strict=True)
                )
        return {}

    _decided(count)
    return complete


def of_cell(model: object, cell: Cell, state: NDArray[np.float64] | None) -> dict[str, Any]:
    """What is proven of the cycle near a state (6,), the cell's numbers as decimals. Raises NotInstalled."""

    def prove() -> dict[str, Any]:
        from kernel.cycles.cycles import cycle_from
        from kernel.proofs import balls, cycles

        if isinstance(model, Rigid):
            law = cycles.Law(repr(model.restitution))
        elif isinstance(model, Soft):
            depth = penetration_of(model, *(np.array([value]) for value in cell[:2]))[0]
            law = cycles.Law(repr(model.restitution), repr(float(depth)), model.adhesive)
        else:
            raise balls.NotCoveredError(f"the contact is {getattr(model, 'kind', model)}")
        if state is None:
            raise balls.NotProvenError("the motion begins at rest: settle first")
        plate = plate_of(model, *(np.array([value]) for value in cell))
        points = (cycle_from(plate, cell, periods, state) for periods in range(1, _MOST_PERIODS + 1))
        point = next((point for point in points if point is not None), None)
        if point is None:
            raise balls.NotProvenError(f"no cycle of up to {_MOST_PERIODS} plate periods is near")
        gamma, omega, xi = (repr(value) for value in cell)
        proof = cycles.prove_cycle(law, gamma, omega, xi, cycles.guess_of(point))
        return {
            "proof_says": f"{proof.says}; the cell's numbers are taken as decimals",
            "proven_flight_times": [balls.bounds(t) for t in proof.flight_times if t > SHORTEST_FLIGHT],
        }

    return {"proven_flight_times": np.empty((0, 2), "U1")} | _decided(prove)


def _decided(prove: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What `prove` returns, with its verdict. Raises NotInstalled without the library of the proofs."""
    if find_spec("flint") is None:
        raise NotInstalled('proofs need the extra proofs: pip install "bouncing-spring[proofs]"')
    from kernel.proofs.balls import NotProvenError

    try:
        return {"proof": "proven"} | prove()
    except NotProvenError as error:
        return {"proof": error.verdict, "proof_says": str(error)}
