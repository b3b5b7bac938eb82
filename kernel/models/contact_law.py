"""The spring-dashpot contact that `soft` and `stepped` share (paper Eqs. 9 to 12; docs/model.md, section 2).

With stiffness kappa = 1/d^2 and damping beta = 2 zeta/d the plate pushes the lower mass with

    n = -(kappa gap + beta gap')        (m A omega^2)

An adhesive contact lasts while gap < 0 and may pull; a nonadhesive one while also n > 0.
"""

from kernel.numerics.jit import compilable, inlined, jit
from kernel.restitution import nonadhesive_duration, scalar_damping_ratio, strong_damping_ratio

compilable(nonadhesive_duration)
compilable(scalar_damping_ratio)
compilable(strong_damping_ratio)


@jit
def damping_ratio(e: float, adhesive: bool) -> float:
    """`kernel.restitution.scalar_damping_ratio`, compiled."""
    return scalar_damping_ratio(e, adhesive)


@inlined
def contact_constants(d: float, zeta: float) -> tuple[float, float]:
    """kappa and beta for penetration d > 0 (plate amplitudes) and damping ratio zeta."""
    return 1.0 / (d * d), 2.0 * zeta / d


@inlined
def plate_force(kappa: float, beta: float, gap: float, gap1: float) -> float:
    """n of a mass in contact at this gap and gap'."""
    return -(kappa * gap + beta * gap1)


@inlined
def lifted_off(gap: float, gap1: float, kappa: float, beta: float) -> bool:
    """Whether a mass with this gap and gap' is not in contact; pass beta = 0 for the adhesive law.

    Only the ratio of kappa to beta matters.
    """
    if gap > 0.0 or (gap == 0.0 and gap1 >= 0.0):
        return True
    return beta > 0.0 and kappa * gap + beta * gap1 >= 0.0


@inlined
def static_state(gamma: float, stiffness: float, kappa: float) -> tuple[float, float]:
    """Gap and elongation (both < 0) of a spring at rest on a plate that does not move.

    stiffness = 1/Omega^2. The plate bears both masses, the spring the upper one.
    """
    return -2.0 / (gamma * kappa), -1.0 / (gamma * stiffness)
