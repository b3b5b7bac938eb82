"""When a spring that moves with the plate first takes off (paper section 3.3.1; docs/model.md, section 5)."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernel.portable_math import hypot

# numpy's own depends on the machine in the last digit
_hypot: Final = np.vectorize(hypot, otypes=[np.float64])


def threshold(omega: ArrayLike, xi: ArrayLike) -> NDArray[np.float64]:
    """Gamma_th of Eq. 25, above which the normal force of the driven motion falls to zero.

    omega > 0 and xi >= 0 broadcast together. Zero for an undamped spring at resonance, infinite for one at
    Omega = sqrt(2).
    """
    omega, xi = np.asarray(omega, dtype=np.float64), np.asarray(xi, dtype=np.float64)
    square = omega * omega
    with np.errstate(divide="ignore"):
        in_contact = _hypot(1.0 - square, 2.0 * xi * omega)
        return np.asarray(2.0 * in_contact / _hypot(2.0 - square, 4.0 * xi * omega))
