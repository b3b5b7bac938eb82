"""The commands on results that the service's views do not make: export, trajectory."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

import click

from service.cli.options import (
    format_option,
    job_argument,
    open_client,
    output_format,
    output_option,
    service_options,
    write_file,
)
from service.formats import (
    EXPORTS,
    DatasetFormat,
    ExportLayout,
)

if TYPE_CHECKING:
    from service.client import Job

_MOTIONS: Final = get_args(DatasetFormat)


@click.command()
@job_argument
@click.option("-o", "--output", type=click.Path(dir_okay=False), required=True,
              help="File to write, .nc or .parquet.")  # fmt: skip
@click.option(
    "--layout", type=click.Choice(get_args(ExportLayout)), default="cells", show_default=True,
    help="What a row of Parquet is: a cell with lists of its flights, or each flight.",
)  # fmt: skip
@service_options
def export(job_id: str, output: str, layout: ExportLayout, url: str, token: str | None) -> None:
    """Write all results of a job to one file, NetCDF or Parquet.

    NetCDF (.nc) contains the arrays of the store, Parquet (.parquet) one row per cell, or with --layout
    flights one row per flight.
    """
    output_format(output, EXPORTS)
    with open_client(url, token) as client:
        job = client.job(job_id)
        job.export(Path(output), layout=layout)
    warn_unless_done(job, "cells are missing")


@click.command()
@click.option("--gamma", type=float, required=True, help="Γ")
@click.option("--omega", type=float, required=True, help="Ω")
@click.option("--xi", type=float, required=True, help="ξ")
@click.option("--model", default="soft", show_default=True, help="Contact model.")
@click.option("--restitution", type=float, help="Restitution of the contact.")
@click.option("--penetration", type=float, help="Penetration of a soft contact, in plate amplitudes.")
@click.option("--settle", type=int, help="Plate periods before the first sample.  [default: 200]")
@click.option("--periods", type=int, help="Plate periods to sample.  [default: 4]")
@click.option("--samples", type=int, help="Samples per plate period.  [default: 200]")
@click.option("--drop", type=(float, float), metavar="HEIGHT PHASE",
              help="Let go at rest, so high (plate amplitudes), at this phase (rad).")  # fmt: skip
@click.option("--contact", type=(float, float), metavar="ELONGATION VELOCITY",
              help="Start in contact: beyond the static one, velocity × Ω.")  # fmt: skip
@format_option(*_MOTIONS)
@output_option
@service_options
def trajectory(
    model: str,
    restitution: float | None,
    penetration: float | None,
    drop: tuple[float, float] | None,
    contact: tuple[float, float] | None,
    format: str | None,
    output: str,
    url: str,
    token: str | None,
    **cell: Any,
) -> None:
    """Write the motion of one cell.

    A row of a table is a sample; lengths are in plate amplitudes. For example:

      bounce trajectory --gamma 2.3 --omega 0.5 --xi 0.26 -o motion.csv
    """
    format = output_format(output, _MOTIONS, format)
    if drop and contact:
        raise click.UsageError("give --drop or --contact, not both")
    if drop:
        cell["start"] = {"kind": "drop", "height": drop[0], "phase": drop[1]}
    if contact:
        cell["start"] = {"kind": "contact", "elongation": contact[0], "velocity": contact[1]}
    cell["model"] = _without_none({"kind": model, "restitution": restitution, "penetration": penetration})
    with open_client(url, token) as client:
        write_file(output, client.trajectory_file(_without_none(cell), format))


COMMANDS: Final = (export, trajectory)


def warn_unless_done(job: "Job", consequence: str) -> None:
    """Say what the reader of a job's results must know, on standard error."""
    if job.notice:
        click.echo(f"the job is {job.notice}", err=True)
    if job.state != "done":
        click.echo(f"the job is {job.state} at {job.progress.whole_percent}%: {consequence}", err=True)


def _without_none(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}
