"""The commands on results: multistability, export, trajectory."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast, get_args

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
    PICTURES,
    TABLES,
    ExportLayout,
    MultistabilityFormat,
)

if TYPE_CHECKING:
    import xarray

    from service.client import Job

_DIAGRAMS: Final = (*PICTURES, *TABLES)
_MULTISTABILITY: Final[tuple[str, ...]] = get_args(MultistabilityFormat)


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
@format_option(*TABLES)
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
    """Write the motion of one cell, as csv or json.

    One row per sample; lengths are in plate amplitudes. For example:

      bounce trajectory --gamma 2.3 --omega 0.5 --xi 0.26 -o motion.csv
    """
    from service.cli.output import trajectory_csv, trajectory_json

    format = output_format(output, TABLES, format)
    if drop and contact:
        raise click.UsageError("give --drop or --contact, not both")
    if drop:
        cell["start"] = {"kind": "drop", "height": drop[0], "phase": drop[1]}
    if contact:
        cell["start"] = {"kind": "contact", "elongation": contact[0], "velocity": contact[1]}
    cell["model"] = _without_none({"kind": model, "restitution": restitution, "penetration": penetration})
    with open_client(url, token) as client:
        motion = client.trajectory(_without_none(cell))
    write_file(output, trajectory_json(motion) if format == "json" else trajectory_csv(motion))


@click.command()
@job_argument
@click.option("--xi", type=float, help="ξ of the plane.")
@click.option("--omega", type=float, help="Ω of a line along Γ.  [default: the whole plane]")
@format_option(*_MULTISTABILITY)
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
    help="File to write; - is standard output.  [default: print a table of the attractors]",
)  # fmt: skip
@service_options
def multistability(
    job_id: str, output: str | None, format: str | None, url: str, token: str | None, **plane: float | None
) -> None:
    """Show the attractors over a grid.

    Of a job with the protocol multistability, the plane at the nearest ξ, or one line of it. Prints the
    attractors, or draws them. For example:

      bounce multistability ID --omega 0.5 -o line.png
    """
    format = None if output is None else output_format(output, _MULTISTABILITY, format)
    with open_client(url, token) as client:
        job = client.job(job_id)
        if output is None:
            click.echo(_over_a_grid(job.multistability(**plane)))
        else:
            write_file(output, job.multistability_picture(cast(MultistabilityFormat, format), **plane))
    warn_unless_done(job, "the plane may be incomplete")


def _over_a_grid(found: "xarray.Dataset") -> str:
    """One line per attractor, then the shares of cells with several and the number of events."""
    lines = [f"{'ID':>4}  {'CELLS':>7}  MOSTLY"]
    columns = [found[name].values.tolist() for name in ("attractor", "cells", "attractor_label")]
    lines += [f"{id:>4}  {cells:>7}  {label}" for id, cells, label in zip(*columns, strict=True)]
    several, by_drops = (found.attrs[name] for name in ("several", "several_by_drops"))
    lines.append(f"cells with two attractors or more: {several:.4f}, reached by drops {by_drops:.4f}")
    kinds = found.kind.values.tolist()
    lines.append(", ".join(f"{name} {kinds.count(kind)}" for name, kind in _KINDS.items()))
    return "\n".join(lines)


_KINDS: Final = {"births": "birth", "deaths": "death", "changes of mode": "mode"}

COMMANDS: Final = (multistability, export, trajectory)


def warn_unless_done(job: "Job", consequence: str) -> None:
    """Say what the reader of a job's results must know, on standard error."""
    if job.notice:
        click.echo(f"the job is {job.notice}", err=True)
    if job.state != "done":
        click.echo(f"the job is {job.state} at {job.progress.whole_percent}%: {consequence}", err=True)


def _without_none(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}
