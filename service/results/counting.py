"""Which flights of a sweep count, and the modes and labels that follow, for every picture and table of it.

Flights up to `min_flight` do not count, unless all of a cell are so short. The default is the `micro_flight`
the sweep was classified with; for another value outcome and mode are found anew from the stored flights.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.labels import LABELS, UNSTABLE, label_codes
from kernel.params import Outcome
from kernel.recount import Modes, recount
from worker import schema
from worker.schema import MODE_ARRAYS
from worker.spec import SweepSpec

#: The stored arrays that a mode is found from.
FLIGHT_ARRAYS: Final = ("flight_time", "takeoff_phase", "flights")


#: What an answer has beside the stored arrays where exponents are stored.
LABEL: Final = schema.Array(
    "label", schema.CELL_DIMS, "|u1", 0,
    {
        "long_name": "outcome, with aperiodic and unstable cells told apart by Lyapunov exponents",
        "units": "1",
        "flag_values": list(range(len(LABELS))),
        "flag_meanings": " ".join(LABELS),
    },
)  # fmt: skip


def shortest(spec: SweepSpec, min_flight: float | None) -> float:
    """The flight in rad above which flights count: `min_flight`, or the sweep's own."""
    return spec.micro_flight if min_flight is None else min_flight


def needs_flights(spec: SweepSpec, min_flight: float | None) -> bool:
    """Whether outcome and mode have to be found anew from the stored flights."""
    return shortest(spec, min_flight) != spec.micro_flight


def arrays_of_modes(spec: SweepSpec, min_flight: float | None) -> tuple[str, ...]:
    """The stored arrays that `recounted` needs."""
    exponents = (schema.LYAPUNOV.name,) if spec.exponents else ()
    flights = FLIGHT_ARRAYS if needs_flights(spec, min_flight) else ()
    computed = () if spec.refine is None else (schema.COMPUTED.name,)
    return (*flights, *MODE_ARRAYS, *exponents, *computed)


def recounted(
    spec: SweepSpec, arrays: Mapping[str, NDArray[Any]], min_flight: float | None
) -> dict[str, NDArray[Any]]:
    """MODE_ARRAYS by name if flights longer than `min_flight` (rad) count, and LABEL if there are exponents.

    Of an adaptive map also `computed`: the other cells have no flights, and keep the mode of their block.
    `arrays` are those of any cells, at least `arrays_of_modes`.
    """
    modes = {name: arrays[name] for name in MODE_ARRAYS}
    if needs_flights(spec, min_flight):
        modes = _found_anew(spec, arrays, shortest(spec, min_flight))
    computed = {} if spec.refine is None else {schema.COMPUTED.name: arrays[schema.COMPUTED.name]}
    return modes | labelled(spec, modes[schema.OUTCOME.name], arrays) | computed


def labelled(
    spec: SweepSpec, outcome: NDArray[np.uint8], arrays: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """The array LABEL by name; nothing where no exponents are stored."""
    if not spec.exponents:
        return {}
    return {LABEL.name: label_codes(outcome, arrays[schema.LYAPUNOV.name], spec.observe)}


def attractor_label(code: int, bounces: int, periods: int) -> str:
    """rest, a mode as (3,4), or the label of an aperiodic attractor; `code`: an outcome or a label's."""
    if code in (Outcome.PERIODIC, UNSTABLE):
        return f"({bounces},{periods})" + (" unstable" if code == UNSTABLE else "")
    return "rest" if code == Outcome.AT_REST else LABELS[code]


def _found_anew(
    spec: SweepSpec, arrays: Mapping[str, NDArray[Any]], min_flight: float
) -> dict[str, NDArray[Any]]:
    shape = arrays["flights"].shape
    times, phases = (arrays[name].reshape(-1, spec.keep) for name in ("flight_time", "takeoff_phase"))
    modes = Modes(
        arrays["outcome"].ravel(),
        arrays["bounces"].ravel().astype(np.int32),  # stores of kernel version 1 have 16 bits
        arrays["periods"].ravel().astype(np.int32),
    )
    found = recount(
        np.ascontiguousarray(times), np.ascontiguousarray(phases), arrays["flights"].ravel(),
        modes, spec.micro_flight, min_flight,
    )  # fmt: skip
    return {name: getattr(found, name).reshape(shape) for name in MODE_ARRAYS}
