"""The measured speed and accuracy of the contact models in words and columns. Plain values in, text out."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

Row = Mapping[str, Any]

_TITLES: Final = {
    "contact": "This very contact is meant: errors from exact soft with d = 1e-3, e = 0.01",
    "plate": "A hard plate is meant: errors from exact soft with d = 1e-7, e = 0",
}
_HEADER: Final = ("", "µs", "dearest", "error", "95%", "mode")


COSTS: Final = ("cost", "cost_most")


def setting(row: Row) -> str:
    """A model and its settings: `stepped 20 verlet, d = 0.001`."""
    words = [row["model"]]
    if row["steps_per_contact"]:
        words.append(f"{row['steps_per_contact']} {row['scheme']}")
    text = " ".join(words)
    if row["penetration"]:
        text += f", d = {row['penetration']:g}"
    if row["model"] == "ball":
        text += ", e = f(xi)" + (", locked dashpot" if row["locked_only"] else "")
    return text


def lines(rows: Sequence[Row]) -> list[str]:
    """The table: core-µs a cell and plate period (median and dearest line of cells), error of flight times
    (median and 95th percentile, rad), and how many cells have the reference's mode."""
    text = []
    for purpose, title in _TITLES.items():
        text += [title, "".join(f"{name:>{10 if i else 36}}" for i, name in enumerate(_HEADER))]
        text += [_line(row) for row in rows if row["purpose"] == purpose]
        text.append("")
    return text


def _line(row: Row) -> str:
    errors = "".join(f"{_error(row[name], row):>10}" for name in ("error", "error_95"))
    costs = "".join(f"{'refused' if row[name] is None else f'{row[name]:.3g}':>10}" for name in COSTS)
    return f"{setting(row):>36}{costs}{errors}{row['agree']:10.0%}"


def _error(error: float | None, row: Row) -> str:
    if error is None:
        return "-"
    return "exact" if error == 0.0 and row["model"] == "soft" else f"{error:.1e}"


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
