"""Checks of the arguments of `kernel.line.run_line` and of the models' `plate` functions.

Every function raises KernelInputError, which names the argument and the rule it breaks.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import MAX_EXPONENTS, MAX_SETTLE_TOLERANCE, STATE_FIELDS, KernelInputError, Start

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
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        if kind != np.float64:
            raise KernelInputError(name, f"must be a float64 array, got {kind}")
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
    settle: int, observe: int, keep: int, micro_flight: float, settle_tolerance: float,
    settle_until: int | None, exponents: int,
) -> None:  # fmt: skip
    """Check an observation window, as in `kernel.line.run_line`.

    settle, observe and settle_until are in plate periods, keep in flights, micro_flight and settle_tolerance
    in rad, exponents a number.
    """
    fewest = settle + observe if is_whole(settle) and is_whole(observe) else 0
    for name, value, least, most in (
        ("settle", settle, 0, math.inf),
        ("observe", observe, 1, math.inf),
        ("keep", keep, 1, math.inf),
        ("settle_until", fewest if settle_until is None else settle_until, fewest, math.inf),
        ("exponents", exponents, 0, MAX_EXPONENTS),
    ):
        if not is_whole(value) or not least <= value <= most:
            raise KernelInputError(name, f"must be an integer from {least} to {most}, got {value!r}")
    for name, length, longest in (
        ("micro_flight", micro_flight, math.inf),
        ("settle_tolerance", settle_tolerance, MAX_SETTLE_TOLERANCE),
    ):
        if not (0.0 <= length <= longest and length < math.inf):
            raise KernelInputError(name, f"must be from 0 to {longest:g} and finite, got {length!r}")


def is_whole(value: object) -> bool:
    """Whether this is an integer, and not True or False."""
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
