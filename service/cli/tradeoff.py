"""The command `bounce tradeoff`: cost and accuracy of the contact models, as a table."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import Any, Final

import click

from service.cli.options import (
    json_option,
    open_client,
    optional_service_options,
    output_format,
    workers_option,
    write_file,
)
from service.formats import PICTURES

Row = Mapping[str, Any]

_HEADER: Final = ("", "µs", "max µs", "error", "95%", "mode")
_COSTS: Final = ("cost", "cost_most")


@click.command()
@click.option("-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
              help="Picture to write as well, .png or .svg.")  # fmt: skip
@json_option
@workers_option
@optional_service_options
def tradeoff(
    output: str | None, as_json: bool, workers: int | None, url: str | None, token: str | None
) -> None:
    """Measure the cost and the accuracy of each contact model.

    Computes a fixed set of cells, extreme ones included, which takes a minute or two, and prints which model
    suits which purpose.
    """
    from service.cli import output as text
    from service.cli.local_service import temporary_service

    format = output_format(output, PICTURES) if output else None
    service = temporary_service(workers) if url is None else nullcontext((url, token))
    with service as address, open_client(*address) as client:
        click.echo("measuring, unless the service has done so already (a minute or two)", err=True)
        measurements = client.tradeoff()
        if output and format:
            write_file(output, client.tradeoff_picture(format))
    click.echo(text.as_json(measurements) if as_json else report(measurements))


def report(measurements: Mapping[str, Any]) -> str:
    """The table, its legend, and the advice; `measurements` is the answer of `GET /v1/tradeoff`."""
    legend = (
        "µs: core-µs per cell per plate period, median over lines of cells; max µs: the most expensive line.",
        "error: of flight times in rad, median and 95th percentile over cells whose reference is periodic.",
        f"mode: share of all {measurements['cells']} cells with the outcome and mode of the reference; "
        f"{measurements['periods']} periods from rest, flights over {measurements['micro_flight']:g} rad.",
    )
    return "\n".join(
        [*table_lines(measurements["rows"], measurements["references"]), *legend, "", measurements["advice"]]
    )


def table_lines(rows: Sequence[Row], references: Mapping[str, str]) -> list[str]:
    """The table, one part per reference that errors are measured from.

    Columns: core-µs per cell per plate period (median and most expensive line of cells), error of flight
    times (median and 95th percentile, rad), share of cells with the outcome and mode of the reference.
    """
    heading = "".join(f"{name:>{10 if i else 36}}" for i, name in enumerate(_HEADER))
    lines = []
    for purpose, reference in references.items():
        lines += [f"Errors relative to the {reference}", heading]
        lines += [_line(row) for row in rows if row["purpose"] == purpose]
        lines.append("")
    return lines


def _line(row: Row) -> str:
    errors = "".join(f"{_error(row[name], row):>10}" for name in ("error", "error_95"))
    costs = "".join(f"{'refused' if row[name] is None else f'{row[name]:.3g}':>10}" for name in _COSTS)
    return f"{_setting(row):>36}{costs}{errors}{row['agree']:10.0%}"


def _setting(row: Row) -> str:
    """A model and its parameters: `stepped 20 verlet, d = 0.001`, with the law where it is nonadhesive."""
    words = [row["model"]]
    if row["steps_per_contact"]:
        words.append(f"{row['steps_per_contact']} {row['scheme']}")
    text = " ".join(words)
    if row["penetration"]:
        text += f", d = {row['penetration']:g}"
    if row["adhesive"] is False:
        text += ", nonadhesive"
    if row["model"] == "ball":
        text += ", e = f(xi)" + (", locked dashpot" if row["locked_only"] else "")
    return text


def _error(error: float | None, row: Row) -> str:
    if error is None:
        return "-"
    return "exact" if error == 0.0 and row["model"] == "soft" else f"{error:.1e}"
