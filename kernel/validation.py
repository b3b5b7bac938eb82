"""Checks of the arguments of `kernel.line.run_line` and of the models' `plate` functions.

Every function raises KernelInputError, which names the argument and the rule it breaks.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import (
    MAX_EXPONENTS,
    MAX_SETTLE_TOLERANCE,
    STATE_FIELDS,
    KernelInputError,
    Start,
)

#: Parameters must lie within this and its inverse. Their squares, such as 1/d^2, then stay within 1e60, and
#: products of four of those, which the kernels form, within a double's range of 1e308.
LARGEST: Final = 1e30

#: What each parameter must satisfy: name -> (test, rule).
_RULES: Final[dict[str, tuple[Callable[[NDArray[np.float64]], NDArray[np.bool_]], str]]] = {
    "gamma": (lambda a: a > 0.0, "must be > 0"),
    "omega": (lambda a: a > 0.0, "must be > 0"),
    "xi": (lambda a: a >= 0.0, "must be >= 0"),
    "restitution": (lambda a: (a >= 0.0) & (a <= 1.0), "must lie in [0, 1]"),
    "penetration": (lambda a: a > 0.0, "must be > 0"),
}


def check_arrays(arrays: dict[str, NDArray[np.float64]]) -> None:
    """Check float64 arrays (n,) of one length, by name, each within its rule."""
    shape = None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype != np.float64:
            kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
            raise KernelInputError(
                name, f"must be a float64 array, got {kind}; numpy.asarray(..., dtype=float) makes one"
            )
        if array.ndim != 1 or len(array) == 0:
            raise KernelInputError(name, f"must have shape (n,) with n >= 1, got {array.shape}")
        shape = shape or array.shape
        if array.shape != shape:
            raise KernelInputError(name, f"must have the shape of gamma, {shape}, got {array.shape}")
        test, rule = _RULES[name]
        wrong = np.flatnonzero(~(np.isfinite(array) & test(array)))
        if len(wrong):
            raise KernelInputError(name, f"{rule} and be finite, got {array[wrong[0]]} at index {wrong[0]}")
        extreme = np.flatnonzero((array != 0.0) & ((array > LARGEST) | (array < 1.0 / LARGEST)))
        if len(extreme) and name != "restitution":  # which the models limit themselves
            i = extreme[0]
            raise KernelInputError(name, f"must lie within 1e-30 and 1e30, got {array[i]} at index {i}")


def check_window(
    settle: int,
    observe: int,
    keep: int,
    micro_flight: float,
    settle_tolerance: float = 0.0,
    settle_until: int | None = None,
    exponents: int = 0,
) -> None:
    """Check an observation window, as in `kernel.line.run_line`.

    settle, observe and settle_until are in plate periods, keep in flights, micro_flight and settle_tolerance
    in rad, exponents a number.
    """
    for name, value, minimum in (("settle", settle, 0), ("observe", observe, 1), ("keep", keep, 1)):
        if not _is_whole(value) or value < minimum:
            raise KernelInputError(name, f"must be an integer >= {minimum}, got {value!r}")
    if settle_until is not None and (not _is_whole(settle_until) or settle_until < settle + observe):
        raise KernelInputError(
            "settle_until",
            f"must be None or an integer >= settle + observe, {settle + observe}, got {settle_until!r}",
        )
    if not _is_whole(exponents) or not 0 <= exponents <= MAX_EXPONENTS:
        raise KernelInputError(
            "exponents", f"must be an integer from 0 to {MAX_EXPONENTS}, got {exponents!r}"
        )
    for name, length in (("micro_flight", micro_flight), ("settle_tolerance", settle_tolerance)):
        if not np.isfinite(length) or length < 0.0:
            raise KernelInputError(name, f"must be >= 0 and finite, got {length!r}")
    if settle_tolerance > MAX_SETTLE_TOLERANCE:
        raise KernelInputError(
            "settle_tolerance", f"must be at most {MAX_SETTLE_TOLERANCE:g}, got {settle_tolerance!r}"
        )


def check_early(settle_early: object, *, carry: bool, exponents: int) -> None:
    """Check that settling may end early: not on a ramp, nor with exponents."""
    if not isinstance(settle_early, bool):
        raise KernelInputError("settle_early", f"must be true or false, got {settle_early!r}")
    if settle_early and (carry or exponents):
        what = "a line that carries its state" if carry else "a run with exponents"
        raise KernelInputError("settle_early", f"must be false on {what}, every cycle of which is computed")


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def checked_state(start: Start) -> NDArray[np.float64]:
    """A copy of the start's state (len(STATE_FIELDS),), checked to be finite and complete."""
    state = np.array(start.state, dtype=np.float64)
    if state.shape != (len(STATE_FIELDS),) or not np.all(np.isfinite(state)):
        raise KernelInputError(
            "start", f"must hold {len(STATE_FIELDS)} finite numbers: {', '.join(STATE_FIELDS)}"
        )
    if not all(np.isfinite(v) and v > 0.0 for v in start.cell[:2]):
        raise KernelInputError("start", "must name the gamma > 0 and omega > 0 of the cell it comes from")
    return state


def checked_states(states: NDArray[np.float64] | None, n: int, *, carry: bool) -> NDArray[np.float64]:
    """The states (n, len(STATE_FIELDS)) that n cells start from, checked; without any rows for None."""
    if states is None:
        return np.empty((0, len(STATE_FIELDS)))
    if carry:
        raise KernelInputError("states", "must be None on a line that carries its state: give `start`")
    array = np.ascontiguousarray(states, dtype=np.float64)
    if array.shape != (n, len(STATE_FIELDS)) or not np.all(np.isfinite(array)):
        rule = f"must hold {len(STATE_FIELDS)} finite numbers for each of {n} cells"
        raise KernelInputError("states", f"{rule}: {', '.join(STATE_FIELDS)}")
    if not np.all((array[:, 0] >= 0.0) & (array[:, 0] < 2.0 * np.pi)):
        raise KernelInputError("states", "must have phases from 0 to 2 pi")
    return array
