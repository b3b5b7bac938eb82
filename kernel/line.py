"""A line of cells along a protocol, to record arrays: the one way into the kernels.

`rest` starts every cell from rest at its own parameters. A ramp carries the state over:
what is kept is the physical motion, and since A goes like Gamma/Omega**2, lengths in plate
amplitudes scale by (Gamma_old/Gamma_new)(Omega_new/Omega_old)**2 and velocities by
(Gamma_old/Gamma_new)(Omega_new/Omega_old) (MODEL section 4).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernel.cell import Window, leave, room_for_flights, run_cell, write
from kernel.interface import flies, prepare, rest
from kernel.models.lockstep import run_lockstep
from kernel.models.rigid import RigidPlate
from kernel.numerics.first_root import NON_FINITE
from kernel.numerics.jit import jit
from kernel.params import STATE_FIELDS, KernelInputError, Line, Start
from kernel.validation import check_arrays, check_window, checked_state


@jit
def _walk(
    plate: Any, gamma: Any, omega: Any, xi: Any,
    carry: bool, started: bool, state: Any, before: Any, window: Window, line: Line,
) -> None:  # fmt: skip
    """Run a line cell by cell, from `state` in the units of `before` = (gamma, omega) if `started`."""
    flights = room_for_flights(line.flight_time.shape[1], 1)
    for i in range(len(gamma)):
        cell = prepare(plate, i, gamma[i], omega[i], xi[i])
        carried = carry and started
        if carried:
            _rescale(state, before, gamma[i], omega[i])
        else:
            state[0] = 0.0
            state[2], state[3], state[4], state[5] = rest(cell)
        in_flight = flies(cell, state[0], state[2], state[3], state[4], state[5])
        state[1] = 1.0 if in_flight else 0.0
        run = run_cell(cell, state, window, flights, carried)
        leave(run, state)
        write(line, i, run, flights, 0, state, window)
        before[0], before[1] = gamma[i], omega[i]
        started = run.ending != NON_FINITE  # nothing can be carried on from there


@jit
def _rescale(state: Any, before: Any, gamma: float, omega: float) -> None:
    velocity = before[0] / gamma * (omega / before[1])
    length = velocity * (omega / before[1])
    state[2] *= length
    state[3] *= velocity
    state[4] *= length
    state[5] *= velocity


def _check_plate(plate: Any, n: int) -> None:
    """What a model's `plate` made, for n cells."""
    if type(plate) not in prepare:
        raise KernelInputError("plate", f"must be made by a model's `plate`, not a {type(plate).__name__}")
    for name, array in plate._asdict().items():
        if isinstance(array, np.ndarray) and array.shape != (n,):
            raise KernelInputError(name, f"must have the shape of gamma, ({n},), got {array.shape}")


def run_line(
    gamma: NDArray[np.float64],
    omega: NDArray[np.float64],
    xi: NDArray[np.float64],
    *,
    plate: Any,
    carry: bool,
    settle: int,
    observe: int,
    keep: int,
    micro_flight: float = 0.0,
    settle_tolerance: float = 0.0,
    start: Start | None = None,
) -> Line:
    """Run n cells in the order given and return their record.

    gamma, omega, xi: float64 (n,). plate: what a model's `plate` makes of its own arrays (n,); its
    type chooses the model. With `carry` each cell goes on from its predecessor's end, the first from
    `start` or from rest; without, every cell starts from rest. settle, observe: plate periods; keep:
    flights stored; micro_flight: rad; with a settle_tolerance (rad) > 0, flights that repeat within
    it end the settling early.

    A trajectory that fails is an outcome. Raises KernelInputError for arguments no cell can have.
    """
    arrays = {"gamma": gamma, "omega": omega, "xi": xi}
    check_arrays(arrays)
    check_window(settle, observe, keep, micro_flight, settle_tolerance)
    _check_plate(plate, len(gamma))
    gamma, omega, xi = (np.ascontiguousarray(a) for a in arrays.values())
    n = len(gamma)
    line = Line(
        np.full((n, keep), np.nan),
        np.full((n, keep), np.nan),
        np.zeros(n, dtype=np.int32),
        np.zeros(n, dtype=np.uint8),
        np.zeros(n, dtype=np.int16),
        np.zeros(n, dtype=np.int16),
        np.full((n, len(STATE_FIELDS)), np.nan),
    )
    state = np.zeros(len(STATE_FIELDS)) if start is None else checked_state(start)
    before = np.ones(2) if start is None else np.array([start.cell.gamma, start.cell.omega])
    window = Window(int(settle), int(observe), float(micro_flight), float(settle_tolerance))
    if isinstance(plate, RigidPlate) and not carry:
        run_lockstep(plate, gamma, omega, xi, window, line)
        return line
    _walk(plate, gamma, omega, xi, bool(carry), start is not None, state, before, window, line)
    return line
