"""Advice on contact models, from their measured cost and accuracy."""

from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]


def advice(rows: Sequence[Row]) -> str:
    """Which rung for which purpose, with the figures just measured."""
    soft = _row(rows, "contact", "soft")
    rigid, plate = _row(rows, "contact", "rigid"), _row(rows, "plate", "rigid")
    stepped = _row(rows, "contact", "stepped", scheme="verlet", steps_per_contact=20)
    ball = _row(rows, "contact", "ball", locked_only=True)
    return (
        f"Take rigid for a hard plate ({plate['cost']:.1g} µs a plate period, {rigid['error']:.0e} rad from "
        f"a contact 1e-3 deep); soft where the contact itself counts, its depth, its rebound, its small hops "
        f"({soft['cost']:.1f} µs, exact, and hardly more if stiffer); ball only where the dashpot locks the "
        f"spring ({ball['cost']:.1g} µs); stepped to compare with studies that took time steps "
        f"({stepped['cost'] / soft['cost']:.0f} times the cost of soft, for {stepped['error']:.0e} rad at 20 "
        "steps a contact); and auto to have the choice made on the cells of your own sweep."
    )


def _row(rows: Sequence[Row], purpose: str, model: str, **wanted: Any) -> Row:
    wanted = {"purpose": purpose, "model": model, **wanted}
    return next(row for row in rows if all(row[name] == value for name, value in wanted.items()))
