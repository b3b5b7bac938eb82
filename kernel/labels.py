"""Labels of cells by their Lyapunov exponents: quasi-periodic, chaotic, or on an unstable cycle.

Needs no numba, as `kernel.params`.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome

#: The label of a cell by its code. The first codes are those of `Outcome`.
LABELS: Final = (*(outcome.name.lower() for outcome in Outcome), "quasi-periodic", "chaotic", "unstable")
QUASI_PERIODIC: Final = LABELS.index("quasi-periodic")
CHAOTIC: Final = LABELS.index("chaotic")
UNSTABLE: Final = LABELS.index("unstable")

#: Errors of an exponent beyond which it is not 0.
SURE: Final = 3.0


def label_codes(outcome: Any, lyapunov: Any, error: Any, observe: int) -> NDArray[np.uint8]:
    """The code in LABELS of cells (...), from their outcomes (...) and exponents (..., n >= 1).

    error: (...) the standard error of lambda_1. The window's resolution is 1/observe per plate period, at
    which variations grow by a factor e over the window. An aperiodic cell is quasi-periodic if |lambda_1| and
    twice its error are within the resolution, and lambda_1 within SURE errors of 0; it is chaotic if lambda_1
    is above the resolution and twice its error. Otherwise it stays aperiodic: the window does not decide, or
    the cell approaches a cycle that is not found, or rest. A periodic cell is unstable if lambda_1 is above
    the resolution, and twice its error is not: rounding holds it on its cycle. The error is larger where a
    chaotic transient ends within the window. Other cells keep their outcome.
    """
    codes: NDArray[np.uint8] = np.array(outcome, np.uint8)
    largest = np.asarray(lyapunov, np.float64)[..., 0]
    error = np.asarray(error, np.float64)
    resolution, uncertainty = 1.0 / observe, 2.0 * error
    aperiodic = codes == Outcome.APERIODIC
    is_zero = np.abs(largest) <= np.minimum(resolution, SURE * error)
    codes[aperiodic & is_zero & (uncertainty <= resolution)] = QUASI_PERIODIC
    codes[aperiodic & (largest > resolution) & (largest > uncertainty)] = CHAOTIC
    held = (largest > resolution) & ~(uncertainty > resolution)  # short windows have no error
    codes[(codes == Outcome.PERIODIC) & held] = UNSTABLE
    return codes
