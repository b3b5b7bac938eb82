"""A line of cells, from arrays of parameters to arrays of records: the entry to the kernels.

Under the protocol `rest` every cell starts from rest at its own parameters. A ramp carries the state over
from cell to cell: the physical motion is kept, and since A is proportional to Gamma/Omega**2, lengths in
plate amplitudes scale by (Gamma_old/Gamma_new)(Omega_new/Omega_old)**2 and velocities by
(Gamma_old/Gamma_new)(Omega_new/Omega_old) (docs/model.md, section 4).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernel.cell import Window, allocate_flights, run_cell
from kernel.exponents import Variations, allocate_variations, write_exponents
from kernel.interface import flies, prepare, rest
from kernel.models import variations as _variations  # noqa: F401 - registers the models' variations
from kernel.models.lockstep import run_lockstep
from kernel.models.rigid import RigidPlate
from kernel.numerics.first_root import NON_FINITE
from kernel.numerics.jit import jit
from kernel.params import STATE_FIELDS, KernelInputError, Line, Start, empty_line
from kernel.validation import check_arrays, check_window, checked_state


@jit
def _walk(
    plate: Any, gamma: Any, omega: Any, xi: Any,
    carry: bool, started: bool, state: Any, before: Any, window: Window, line: Line,
    variations: Variations | None,
) -> None:  # fmt: skip
    """Run a line cell by cell and fill `line`.

    With `carry`, from cell to cell; the first cell goes on from `state` (6,), in the units of `before` =
    (gamma, omega), if `started`. Both arrays are overwritten. `variations`: for the exponents, or None.
    """
    flights = allocate_flights(line.flight_time.shape[1], 1)
    for i in range(len(gamma)):
        cell = prepare(plate, i, gamma[i], omega[i], xi[i])
        if carry and started:
            _rescale(state, before, gamma[i], omega[i])
        else:
            state[0], state[1] = 0.0, 0.0
            state[2], state[3], state[4], state[5] = rest(cell)
        in_flight = flies(cell, state[0], state[2], state[3], state[4], state[5])
        takes_off = in_flight and state[1] == 0.0
        state[1] = 1.0 if in_flight else 0.0
        run = run_cell(cell, state, window, flights, takes_off, line, i, variations)
        if variations is not None:
            write_exponents(line.lyapunov[i], run.ending, variations)
        before[0], before[1] = gamma[i], omega[i]
        started = run.ending != NON_FINITE  # after a diverged cell the next one starts from rest


@jit
def _rescale(state: Any, before: Any, gamma: float, omega: float) -> None:
    """Convert `state` (6,) from the plate amplitude of `before` = (gamma, omega) to that of the new cell."""
    velocity = before[0] / gamma * (omega / before[1])
    length = velocity * (omega / before[1])
    state[2] *= length
    state[3] *= velocity
    state[4] *= length
    state[5] *= velocity


def _check_plate(plate: Any, n: int) -> None:
    """Check that a model's `plate` function made this, for n cells. Raises KernelInputError."""
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
    settle_until: int | None = None,
    exponents: int = 0,
    start: Start | None = None,
) -> Line:
    """Run n cells in the given order and return their record.

    gamma, omega, xi: float64 (n,). plate: made by a model's `plate` function from its own arrays (n,); its
    type selects the model. With `carry` each cell continues from its predecessor's end, the first from
    `start` or from rest; without, every cell starts from rest. settle, observe: plate periods discarded
    and recorded. keep: flights stored. micro_flight: rad; shorter flights do not count for the mode, unless
    all are. settle_tolerance: rad; if > 0, flights that repeat within it end the settling early.
    settle_until: plate periods that a cell still settling may take in all; None: no more than the window.
    The periods are doubled as long as the cell settles, and the last `observe` of them are recorded.
    exponents: Lyapunov exponents to compute.

    A trajectory that fails is an outcome, not an exception. Raises KernelInputError for arguments outside
    what a kernel can compute.
    """
    arrays = {"gamma": gamma, "omega": omega, "xi": xi}
    check_arrays(arrays)
    check_window(settle, observe, keep, micro_flight, settle_tolerance, settle_until, exponents)
    _check_plate(plate, len(gamma))
    gamma, omega, xi = (np.ascontiguousarray(a) for a in arrays.values())
    n = len(gamma)
    line = empty_line(n, keep, exponents)
    state = np.zeros(len(STATE_FIELDS)) if start is None else checked_state(start)
    before = np.ones(2) if start is None else np.array([start.cell.gamma, start.cell.omega])
    window = Window(
        int(settle), int(observe), float(micro_flight), float(settle_tolerance),
        int(settle_until or 0), int(exponents),
    )  # fmt: skip
    variations = allocate_variations(plate, exponents) if exponents else None
    if isinstance(plate, RigidPlate) and not carry and variations is None:
        run_lockstep(plate, gamma, omega, xi, window, line)
        return line
    _walk(plate, gamma, omega, xi, bool(carry), start is not None, state, before, window, line, variations)
    return line
