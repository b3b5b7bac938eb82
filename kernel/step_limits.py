"""Limits on the fixed time steps of `stepped`, for arrays; no numba.

The paper's rule (Eq. 13) is a step of the contact's duration over 20 to 100. It considers the contact
alone: a stiff spring, a strong dashpot, or a restitution so small that the contact lasts long may need a
shorter step for the scheme to be stable at all.

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

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernel.portable_math import hypot
from kernel.restitution import contact_time, damping_ratio

MOST_STEPS_PER_PERIOD: Final = 10_000_000  # more are refused, as unresolved: such a period takes 40 ms
_MAX_COUNT: Final = 1e18  # more steps are cut to this before they are converted to integers
_HALVINGS: Final = 60  # of the bracket of Euler's stable step: to 2**-60 of Verlet's, below rounding

_Array = NDArray[np.float64]

_hypot: Final = np.vectorize(hypot, otypes=[np.float64])  # numpy's own depends on the machine


#: Velocity Verlet, of second order, a step's second half using the velocity at its end; and semi-implicit
#: Euler, of first order.
Scheme = Literal["verlet", "euler"]


def _largest_eigenvalue(spring: _Array, contact: _Array) -> _Array:
    """The largest eigenvalue of spring * L + contact * E (see the module's text), elementwise."""
    return np.asarray(spring + 0.5 * contact + _hypot(spring, 0.5 * contact))


def largest_stable_step(
    omega: ArrayLike, xi: ArrayLike, restitution: ArrayLike, penetration: ArrayLike, *,
    adhesive: bool = True, scheme: Scheme = "verlet",
) -> _Array:  # fmt: skip
    """The step (rad) below which the scheme is stable in contact and in flight, and above which it is not.

    The positional arguments, in the ranges of docs/model.md, section 1, broadcast together. Under Verlet
    in closed form, under Euler by bisection.
    """
    omega, xi, e, d = np.broadcast_arrays(
        *(np.asarray(a, float) for a in (omega, xi, restitution, penetration))
    )
    w, kappa = 1.0 / omega**2, 1.0 / d**2
    verlet = 2.0 / np.sqrt(_largest_eigenvalue(w, kappa))
    if scheme == "verlet":
        return np.asarray(verlet)
    b, beta = 2.0 * xi / omega, 2.0 * damping_ratio(e, adhesive) / d
    low, high = np.zeros_like(verlet), verlet
    for _ in range(_HALVINGS):
        h = 0.5 * (low + high)
        stable = _largest_eigenvalue(h * (h * w + 2.0 * b), h * (h * kappa + 2.0 * beta)) < 4.0
        low, high = np.where(stable, h, low), np.where(stable, high, h)
    return low


def steps_per_period(
    restitution: ArrayLike, penetration: ArrayLike, steps_per_contact: int, *, adhesive: bool = True
) -> NDArray[np.int64]:
    """Steps per plate period under the paper's rule (Eq. 13), an array of integers.

    The fewest whose length is at most the contact's duration over `steps_per_contact`.
    """
    longest = contact_time(restitution, penetration, adhesive) / steps_per_contact
    return np.maximum(np.ceil(np.minimum(2.0 * np.pi / longest, _MAX_COUNT)), 1.0).astype(np.int64)


def stable_steps_per_contact(
    omega: ArrayLike, xi: ArrayLike, restitution: ArrayLike, penetration: ArrayLike, *,
    adhesive: bool = True, scheme: Scheme = "verlet",
) -> NDArray[np.int64]:  # fmt: skip
    """The fewest `steps_per_contact` that are stable; the positional arguments broadcast together."""
    longest = largest_stable_step(omega, xi, restitution, penetration, adhesive=adhesive, scheme=scheme)
    fewest = contact_time(restitution, penetration, adhesive) / longest
    # stability excludes the limit itself; 1e-12 is far above the rounding of the quotient
    return np.asarray(np.floor(np.minimum(fewest * (1.0 + 1e-12), _MAX_COUNT)) + 1.0).astype(np.int64)
