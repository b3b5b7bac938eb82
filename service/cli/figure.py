"""The command `bounce figure`: a figure from submission to picture."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Final

import click

from service.cli.options import (
    data_option,
    optional_service_options,
    output_format,
    was_default_or_variable,
    workers_option,
    write_file,
)
from service.formats import PICTURES

#: Seconds for one answer: the first trajectory waits until the kernels are compiled.
COMPILE_SECONDS: Final = 300.0


@click.command()
@click.argument("number", metavar="N|all")
@click.option("-o", "--output", type=click.Path(allow_dash=True),
              help="A png, svg or pdf; for all, a folder.  [default: figure-N.png; figures]")  # fmt: skip
@click.option("--format", type=click.Choice(PICTURES), default="png", show_default=True,
              help="Format of the files in the folder.")  # fmt: skip
@data_option
@workers_option
@optional_service_options
def figure(
    number: str,
    output: str | None,
    format: str,
    data: str | None,
    workers: int | None,
    url: str | None,
    token: str | None,
) -> None:
    """Make figure N of the paper, or all, from start to end.

    Starts a local service with two worker processes, submits the sweeps of the figures, draws the results and
    prints how they compare with the paper. A second run finds the finished jobs in the data folder and only
    draws. If a service runs on the data folder, that service is used.
    """
    from service.cli.local_service import Address, persistent_service
    from service.client import Client
    from service.figures import catalogue

    if data is not None and not was_default_or_variable("url"):
        raise click.UsageError("--data names the folder of a local service, --url another service: give one")
    figures = catalogue.figures(number)
    if number == "all":
        folder = Path(output or "figures")
        folder.mkdir(parents=True, exist_ok=True)
        targets = [str(folder / f"figure-{figure.number}.{format}") for figure in figures]
    else:
        targets = [output or f"figure-{number}.{format}"]
        format = output_format(targets[0], PICTURES)
    if url is None or data is not None:
        service: AbstractContextManager[Address] = persistent_service(workers, data, token)
    else:
        service = nullcontext(Address(url, token))
    with service as address, Client(*address, timeout=COMPILE_SECONDS) as client:
        for target, drawing in zip(targets, catalogue.make(figures, client), strict=True):
            write_file(target, drawing.encoded(format))
            click.echo(f"{target}\n{drawing.caption}\n", err=True)
