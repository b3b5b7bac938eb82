"""How long the fixed time steps of `stepped` may be; for whole arrays and without numba.

The paper's rule (Eq. 13) is a step of the contact's duration over 20 to 100. It looks at the
contact alone: a stiff spring, a strong dashpot, or a restitution so small that the contact
lasts long may need a shorter one for the scheme to be stable at all.

Let x = (upper mass, lower mass), x'' = -K x - C x' + f with K = w L + kappa E and
C = b L + beta E, where L = ((1, -1), (-1, 1)), E = ((0, 0), (0, 1)), w = 1/Omega**2,
b = 2 xi/Omega, and kappa = 1/d**2 and beta = 2 zeta/d in contact, 0 in flight. For a solution
x_n = s**n u of either scheme, k = u*Ku/u*u and c = u*Cu/u*u are real and >= 0, and
    verlet  s**2 (1 + hc/2) - s (2 - h**2 k) + (1 - hc/2) = 0
    euler   s**2 - s (2 - h**2 k - hc) + (1 - hc) = 0
keep |s| <= 1 while h**2 k < 4 and h**2 k + 2 hc < 4. So h is stable while
    verlet  h**2 K < 4         euler  h**2 K + 2 h C < 4
as matrices, and no longer: where these turn singular, s = -1 solves the first equations. Both
grow with kappa and beta, so the contact's limit is the tighter one and holds in flight too.
"""

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernel.restitution import contact_time, damping_ratio

#: More steps in a plate period than this are refused; a cell that asks for them is unresolved.
MOST_STEPS_PER_PERIOD: Final = 10_000_000

_Array = NDArray[np.float64]


class Scheme(IntEnum):
    """How a step is taken."""

    VERLET = 0  # velocity Verlet, second order; a step's second half uses the velocity at its end
    EULER = 1  # semi-implicit Euler, first order


def _largest_eigenvalue(spring: _Array, contact: _Array) -> _Array:
    """Of spring * L + contact * E."""
    return spring + 0.5 * contact + np.hypot(spring, 0.5 * contact)


def largest_stable_step(
    omega: ArrayLike,
    xi: ArrayLike,
    restitution: ArrayLike,
    penetration: ArrayLike,
    *,
    adhesive: bool = True,
    scheme: Scheme = Scheme.VERLET,
) -> _Array:
    """The step (rad) below which the scheme is stable in contact and in flight, and above which it is not.

    All arguments but the last two broadcast together.
    """
    omega, xi, e, d = np.broadcast_arrays(
        *(np.asarray(a, float) for a in (omega, xi, restitution, penetration))
    )
    w, kappa = 1.0 / omega**2, 1.0 / d**2
    verlet = 2.0 / np.sqrt(_largest_eigenvalue(w, kappa))
    if scheme == Scheme.VERLET:
        return np.asarray(verlet)
    b, beta = 2.0 * xi / omega, 2.0 * damping_ratio(e, adhesive) / d
    low, high = np.zeros_like(verlet), verlet
    for _ in range(60):
        h = 0.5 * (low + high)
        stable = _largest_eigenvalue(h * (h * w + 2.0 * b), h * (h * kappa + 2.0 * beta)) < 4.0
        low, high = np.where(stable, h, low), np.where(stable, high, h)
    return low


def steps_per_period(
    restitution: ArrayLike, penetration: ArrayLike, steps_per_contact: int, *, adhesive: bool = True
) -> NDArray[np.int64]:
    """Steps in a plate period, so that each is at most the contact's duration over `steps_per_contact`.

    The step itself is 2 pi over this: a whole number of steps makes a plate period.
    """
    wanted = contact_time(restitution, penetration, adhesive) / steps_per_contact
    return np.maximum(np.ceil(np.minimum(2.0 * np.pi / wanted, 1e18)), 1.0).astype(np.int64)


def stable_steps_per_contact(
    omega: ArrayLike,
    xi: ArrayLike,
    restitution: ArrayLike,
    penetration: ArrayLike,
    *,
    adhesive: bool = True,
    scheme: Scheme = Scheme.VERLET,
) -> NDArray[np.int64]:
    """The fewest `steps_per_contact` that are stable; the arguments broadcast together."""
    longest = largest_stable_step(omega, xi, restitution, penetration, adhesive=adhesive, scheme=scheme)
    fewest = contact_time(restitution, penetration, adhesive) / longest
    return np.asarray(np.floor(np.minimum(fewest * (1.0 + 1e-12), 1e18)) + 1.0).astype(np.int64)
