"""Thresholds in closed form as JSON. Null stands for a number there is not."""

from kernel.branches.descent import lifetime
from kernel.branches.energy import Energy
from kernel.branches.thresholds import Thresholds
from service.render.text import to_json


def thresholds_json(thresholds: Thresholds, delta: float) -> bytes:
    """The thresholds of one spring; `lifetime` is that of bouncing at Γ = down - delta."""
    fold = thresholds.fold
    return to_json(
        {
            "omega": thresholds.omega,
            "xi": thresholds.xi,
            "threshold": thresholds.gamma_th,
            "jump": thresholds.jump,
            "down": thresholds.down,
            "cause": thresholds.cause,
            "reason": thresholds.reason or None,
            "lifetime": None if fold is None else {"delta": delta, "periods": lifetime(fold, delta)},
            "energy": None if thresholds.energy is None else _only(thresholds.energy),
        }
    )


def _only(energy: Energy) -> dict[str, float]:
    """The balance of a single cycle."""
    return {name: float(values[0]) for name, values in energy._asdict().items()}
