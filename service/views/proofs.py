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
#: The cycle of a state that has settled differs by less from the round that begins there: others lie beside.
_NEAR: Final = 1e-2
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
    """What is proven of the fold at which bouncing ends. Raises NotInstalled."""

    def prove() -> dict[str, Any]:
        from kernel.proofs import balls, branches

        if fold is None:
            raise balls.NotProvenError("bouncing does not end at a fold", "not covered")
        proof = branches.prove_down(omega, xi, fold)
        return {
            "proof_says": f"{proof.says}; omega = {omega!r} and xi = {xi!r} are these decimals",
            "down_at_most": balls.bounds(proof.gamma)[1],
            "proven_flight_time": balls.bounds(proof.flight_times[0]),
        }

    return {"down_at_most": "", "proven_flight_time": ("", "")} | _decided(prove)


def of_events(events: Events) -> NDArray[np.bool_]:
    """Of each event of a (1,k) branch, whether all of its kind were counted. Raises NotInstalled."""

    def count() -> dict[str, Any]:
        from kernel.proofs.branches import all_events

        omega, xi, periods = (x[0].item() for x in (events.omega, events.xi, events.periods))
        counted = np.array([float(t) for t in all_events(kind, omega, xi, periods)])
        times = np.sort(events.flight_time[events.kind == kind])
        return {"all": len(counted) == len(times) and np.abs(counted - times).max() < _SAME}

    complete = np.zeros(len(events.kind), np.bool_)
    for kind in {Kind.FOLD, Kind.FLIP} & set(events.kind.tolist()):
        complete[events.kind == kind] = _decided(count).get("all", False)
    return complete


def of_cell(model: object, cell: Cell, state: NDArray[np.float64] | None) -> dict[str, Any]:
    """What is proven of the cycle near a state (6,). Raises NotInstalled."""

    def prove() -> dict[str, Any]:
        from kernel.cycles.cycles import cycle_from
        from kernel.cycles.descent import cycle_of
        from kernel.proofs import balls, cycles

        if state is None:
            raise balls.NotProvenError("the motion begins at rest: settle first")
        if not isinstance(model, Rigid | Soft):
            raise balls.NotProvenError(f"the contact is {getattr(model, 'kind', model)}", "not covered")
        arrays = [np.array([value]) for value in cell]
        law = cycles.Law(model.restitution)
        if isinstance(model, Soft):
            law = law._replace(
                penetration=penetration_of(model, *arrays[:2])[0].item(), adhesive=model.adhesive
            )
        plate = plate_of(model, *arrays)
        each = range(1, _MOST_PERIODS + 1)
        points = (cycle_from(plate, cell, periods, state, _NEAR) for periods in each)
        point = next(filter(None, points), None)
        if point is None:
            raise balls.NotProvenError(f"no cycle of up to {_MOST_PERIODS} plate periods is near")
        point = point.begun(
            (point.letters.find("S") + 1) % len(point.letters)
        )  # where a mass that stuck takes off
        proof = cycles.prove_cycle(law, cell, cycle_of(point))
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
