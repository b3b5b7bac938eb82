"""The command `bounce tradeoff`: cost and accuracy of the contact models, as a table and a picture."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, cast

import click

from service.cli.options import json_option, output_format, write_file
from service.formats import PICTURES, PictureFormat

if TYPE_CHECKING:
    from worker.analysis.work_precision import Measurement

#: What each purpose's errors are measured from.
REFERENCES: Final = {
    "adhesive": "exact soft contact, adhesive, d = 1e-3, e = 0.01: for studies of this contact",
    "nonadhesive": "exact soft contact, nonadhesive, d = 1e-3, e = 0.01: for studies of this contact",
    "plate": "exact soft contact, nonadhesive, d = 1e-7, e = 1e-6: for studies of a hard plate",
}
_HEADER: Final = ("", "µs", "max µs", "error", "95%", "mode")


@click.command()
@click.option("-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
              help="Picture to write as well, .png, .svg or .pdf.")  # fmt: skip
@json_option
def tradeoff(output: str | None, as_json: bool) -> None:
    """Measure the cost and the accuracy of each contact model.

    Computes a fixed set of cells, extreme ones included, one after another in this process, which takes a
    minute or two, and prints which model suits which purpose.
    """
    from service.cli import output as text
    from service.local import claim_kernels

    format = output_format(output, PICTURES) if output else None
    claim_kernels()
    from service.render import work_precision as picture
    from worker.analysis import work_precision

    click.echo("measuring (two or three minutes)", err=True)
    rows = [work_precision.measure(setup) for setup in work_precision.SETUPS]
    if output and format:
        write_file(output, picture.draw(rows, cast(PictureFormat, format)))
    measurements = table(rows)
    click.echo(text.as_json(measurements) if as_json else report(measurements))


def table(rows: "Sequence[Measurement]") -> dict[str, Any]:
    """The measurements, what they were taken over, and the advice."""
    from worker.analysis import work_precision

    return {
        "rows": [row.model_dump() for row in rows],
        "cells": len(work_precision.LINES) * work_precision.CELLS_PER_LINE,
        "periods": work_precision.SETTLE + work_precision.OBSERVE,
        "micro_flight": work_precision.MICRO_FLIGHT,
        "references": REFERENCES,
        "advice": advice(rows),
    }


def advice(rows: "Sequence[Measurement]") -> str:
    """Which model to take for which purpose, with the costs and errors just measured."""

    def find(purpose: str, **settings: Any) -> Any:
        """The first such row; Any, because the models of the advice always have a cost and an error."""
        settings = {"purpose": purpose, **settings}
        return next(row for row in rows if settings.items() <= row.model_dump().items())

    soft = find("adhesive", model="soft")
    rigid, hard = find("adhesive", model="rigid"), find("plate", model="rigid")
    stepped = find("adhesive", model="stepped", scheme="verlet", steps_per_contact=20)
    ball = find("adhesive", model="ball", locked_only=True)
    return (
        f"Take rigid for a hard plate ({hard.cost:.1g} µs per plate period, {rigid.error:.0e} rad from a "
        "contact 1e-3 deep); soft where the contact itself matters, its depth, its rebound, its small "
        f"flights ({soft.cost:.1f} µs, exact, and little more for a stiffer contact); ball only where "
        f"the dashpot locks the spring ({ball.cost:.1g} µs); stepped to compare with studies that took "
        f"time steps ({stepped.cost / soft.cost:.0f} times the cost of soft, for {stepped.error:.0e} rad at "
        "20 steps per contact); and auto to choose the model on the cells of your own sweep."
    )


def report(measurements: Mapping[str, Any]) -> str:
    """The table, one part per reference that errors are measured from, its legend, and the advice."""
    heading = "".join(f"{name:>{10 if i else 36}}" for i, name in enumerate(_HEADER))
    lines = []
    for purpose, reference in measurements["references"].items():
        rows = [_line(row) for row in measurements["rows"] if row["purpose"] == purpose]
        lines += [f"Errors relative to the {reference}", heading, *rows, ""]
    legend = (
        "µs: core-µs per cell per plate period, median over lines of cells; max µs: the most expensive line.",
        "error: of flight times in rad, median and 95th percentile over cells whose reference is periodic.",
        f"mode: share of all {measurements['cells']} cells with the outcome and mode of the reference; "
        f"{measurements['periods']} periods from rest, flights over {measurements['micro_flight']:g} rad.",
    )
    return "\n".join([*lines, *legend, "", measurements["advice"]])


def _line(row: Mapping[str, Any]) -> str:
    costs = ["refused" if cost is None else f"{cost:.3g}" for cost in (row["cost"], row["cost_most"])]
    errors = [_error(error, row) for error in (row["error"], row["error_95"])]
    return (
        f"{_setting(row):>36}" + "".join(f"{each:>10}" for each in costs + errors) + f"{row['agree']:10.0%}"
    )


def _setting(row: Mapping[str, Any]) -> str:
    """A model and its parameters: `stepped 20 verlet, d = 0.001`, with the law where it is nonadhesive."""
    parts = [row["model"]]
    if row["steps_per_contact"]:
        parts[0] += f" {row['steps_per_contact']} {row['scheme']}"
    if row["penetration"]:
        parts.append(f"d = {row['penetration']:g}")
    if row["adhesive"] is False:
        parts.append("nonadhesive")
    if row["model"] == "ball":
        parts += ["e = f(xi)", *(["locked dashpot"] if row["locked_only"] else [])]
    return ", ".join(parts)


def _error(error: float | None, row: Mapping[str, Any]) -> str:
    if error is None:
        return "-"
    return "exact" if error == 0.0 and row["model"] == "soft" else f"{error:.1e}"
