"""The command `bounce tradeoff`. Light to import: what takes long is imported when it runs."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import click

from service.cli.options import connected, format_of, write_file

PICTURES: Final = ("png", "svg")

Row = Mapping[str, Any]

_TITLES: Final = {
    "contact": "This very contact is meant: errors from exact soft with d = 1e-3, e = 0.01",
    "plate": "A hard plate is meant: errors from exact soft with d = 1e-7, e = 0",
}
_HEADER: Final = ("", "µs", "dearest", "error", "95%", "mode")
COSTS: Final = ("cost", "cost_most")


@click.command()
@click.option("-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
              help="Picture to write beside the table, .png or .svg.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--workers", type=int, help="Processes of the embedded cluster.  [default: 2]")
@click.option("--url", help="Use the service that listens here instead of an embedded one.")
@click.option("--token", envvar="BOUNCE_TOKEN", help="What that service asks for, if it does.")
def tradeoff(
    output: str | None, as_json: bool, workers: int | None, url: str | None, token: str | None
) -> None:
    """Measure what each contact model costs and how far off it is.

    Takes a minute of computing, over a fixed set of cells with extremes among them. Ends with which model to
    take for which purpose.
    """
    from service.cli import output as listing

    format = format_of(output, PICTURES) if output else None
    with _service(url, workers) as address, connected(address, token) as client:
        click.echo("measuring, unless it is done already (about half a minute)", err=True)
        found = client.tradeoff()
        if output and format:
            write_file(output, client.tradeoff_picture(format))
    click.echo(listing.as_json(found) if as_json else report(found))


def report(found: dict[str, Any]) -> str:
    """The table and how to read it."""
    notes = (
        "µs: of one core, a cell and plate period, median over lines of cells; dearest: of the dearest line.",
        "error: of flight times in rad, median and 95th percentile over the cells whose reference repeats.",
        f"mode: share of all {found['cells']} cells with the reference's outcome and mode; "
        f"{found['periods']} periods from rest, flights over {found['micro_flight']:g} rad.",
    )
    return "\n".join([*lines(found["rows"]), *notes, "", found["advice"]])


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


@contextmanager
def _service(url: str | None, workers: int | None) -> Iterator[str]:
    """The address of the service that was named, or of one that lives and keeps its data for this block."""
    if url is not None:
        yield url
        return
    from worker.kernel_cache import claim_cache

    claim_cache()
    from service.server import embedded

    click.echo("starting a service and its workers (the first time, a minute to compile)", err=True)
    with tempfile.TemporaryDirectory(prefix="bounce-") as data:
        settings = embedded.settings(workers=workers, data=data, host="127.0.0.1", port=0)
        with embedded.running(settings) as address:
            yield address
