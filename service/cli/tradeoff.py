"""The command `bounce tradeoff`. Light to import: what takes long is imported when it runs."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import click

from service.cli.options import connected, format_of, write_file

PICTURES: Final = ("png", "svg")


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
    from service.results import work_precision

    format = format_of(output, PICTURES) if output else None
    with _service(url, workers) as address, connected(address, token) as client:
        click.echo("measuring, unless it is done already (about half a minute)", err=True)
        found = client.tradeoff()
        if output and format:
            write_file(output, client.tradeoff_picture(format))
    click.echo(listing.as_json(found) if as_json else report(found, work_precision.lines(found["rows"])))


def report(found: dict[str, Any], lines: list[str]) -> str:
    """The table and how to read it."""
    notes = (
        "µs: of one core, a cell and plate period, median over lines of cells; dearest: of the dearest line.",
        "error: of flight times in rad, median and 95th percentile over the cells whose reference repeats.",
        f"mode: share of all {found['cells']} cells with the reference's outcome and mode; "
        f"{found['periods']} periods from rest, flights over {found['micro_flight']:g} rad.",
    )
    return "\n".join([*lines, *notes, "", found["advice"]])


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
