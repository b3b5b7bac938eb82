"""What is proven of a spring's threshold and of a cell's cycle (docs/proofs.md). Needs the extra `proofs`."""

from collections.abc import Callable
from enum import StrEnum
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.branches.folds import Fold
from kernel.cell import SHORTEST_FLIGHT
from kernel.params import Cell
from service.errors import NotInstalled
from service.views.variables import row
from worker.spec.contact_models import Rigid, Soft, penetration_of
from worker.work import plate_of

#: Digits of an enclosure's ends.
_DIGITS: Final = 18

#: Plate periods of the cycles that are looked for at a cell.
_MOST_PERIODS: Final = 12


class Verdict(StrEnum):
    """What is known of a statement."""

    PROVEN = "proven"
    DISPROVEN = "disproven"
    NOT_PROVEN = "not proven"
    NOT_COVERED = "not covered"


OF_THRESHOLD: Final = (
    row("proof", (), "U", "proven, disproven, not proven or not covered"),
    row("proof_says", (), "U", "the statement, or why there is none"),
    row("down_at_most", (), "U", "proven upper bound of down, rounded up"),
    row("proven_flight_time", ("bound",), "U", "flight time at the fold lies between", "rad"),
)
OF_CELL: Final = (
    *OF_THRESHOLD[:2],
    row(
        "proven_flight_times", ("cycle_flight", "bound"), "U", "each flight of the cycle lies between", "rad"
    ),
)


def check_installed() -> None:
    """Raises NotInstalled without the library of the proofs."""
    if find_spec("flint") is None:
        raise NotInstalled('proofs need the extra proofs: pip install "bouncing-spring[proofs]"')


def of_threshold(omega: float, xi: float, fold: Fold | None) -> dict[str, Any]:
    """What is proven of the fold at which bouncing ends, Ω and ξ as decimals. Raises NotInstalled."""
    check_installed()
    from kernel.proofs.balls import NotCoveredError, bounds
    from kernel.proofs.thresholds import prove_down

    def prove() -> dict[str, Any]:
        if fold is None:
            raise NotCoveredError("bouncing does not end at a fold")
        proof = prove_down(repr(omega), repr(xi), fold)
        return {
            "proof_says": f"{proof.says}; omega = {omega!r} and xi = {xi!r} are these decimals",
            "down_at_most": bounds(proof.at_most, _DIGITS)[1],
            "proven_flight_time": bounds(proof.flight_time, _DIGITS),
        }

    return {"down_at_most": "", "proven_flight_time": ("", "")} | _decided(prove)


def of_cell(model: object, cell: Cell, state: NDArray[np.float64] | None) -> dict[str, Any]:
    """What is proven of the cycle near a state (6,), the cell's numbers as decimals. Raises NotInstalled."""
    check_installed()
    from kernel.branches.cycles import cycle_from
    from kernel.proofs.balls import NotCoveredError, NotProvenError, bounds
    from kernel.proofs.cycles import Law, guess_of, prove_cycle

    def prove() -> dict[str, Any]:
        if isinstance(model, Rigid):
            law = Law(repr(model.restitution))
        elif isinstance(model, Soft):
            depth = penetration_of(model, *(np.array([value]) for value in cell[:2]))[0]
            law = Law(repr(model.restitution), repr(float(depth)), model.adhesive)
        else:
            raise NotCoveredError(f"the contact is {getattr(model, 'kind', model)}")
        if state is None:
            raise NotProvenError("the motion begins at rest: settle first")
        plate = plate_of(model, *(np.array([value]) for value in cell))
        points = (cycle_from(plate, cell, periods, state) for periods in range(1, _MOST_PERIODS + 1))
        point = next((point for point in points if point is not None), None)
        if point is None:
            raise NotProvenError(f"no cycle of up to {_MOST_PERIODS} plate periods is near")
        gamma, omega, xi = (repr(value) for value in cell)
        proof = prove_cycle(law, gamma, omega, xi, guess_of(point))
        digits = [bounds(time, _DIGITS) for time in proof.flight_times if time > SHORTEST_FLIGHT]
        says = (
            f"exactly one cycle of {proof.periods} plate periods and {len(digits)} flights lies here; it is "
            "admissible and stable; gamma, omega, xi and the contact's numbers are these decimals"
        )
        return {"proof_says": says, "proven_flight_times": digits}

    return {"proven_flight_times": np.empty((0, 2), "U1")} | _decided(prove)


def _decided(prove: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What `prove` returns, with its verdict."""
    from kernel.proofs.balls import DisprovenError, NotCoveredError, NotProvenError

    try:
        return {"proof": Verdict.PROVEN.value} | prove()
    except DisprovenError as error:
        verdict, why = Verdict.DISPROVEN, str(error)
    except NotCoveredError as error:
        verdict, why = Verdict.NOT_COVERED, str(error)
    except NotProvenError as error:
        verdict, why = Verdict.NOT_PROVEN, str(error)
    return {"proof": verdict.value, "proof_says": why}
