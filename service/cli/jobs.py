"""The commands of `bounce` that change a job, follow it, or fetch what it found beyond a diagram."""

import csv
import json
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from service.cli.options import connected, format_of, output_option, service_options, write_file

if TYPE_CHECKING:
    import xarray

TABLES: Final = ("csv", "json")
FILES: Final = ("nc", "parquet")


@click.command()
@click.argument("job_id", metavar="ID")
@service_options
def resume(job_id: str, url: str, token: str | None) -> None:
    """Let job ID, failed or cancelled, go on where it stopped."""
    from service.client.display import summary

    with connected(url, token) as client:
        click.echo(summary(client.job(job_id).resume()), err=True)


@click.command()
@click.argument("job_id", metavar="ID")
@service_options
def delete(job_id: str, url: str, token: str | None) -> None:
    """Forget job ID and remove all it computed. One in work is to be cancelled first."""
    with connected(url, token) as client:
        client.job(job_id).delete()


@click.command()
@click.argument("job_id", metavar="ID")
@click.option("--json", "as_json", is_flag=True, help="Print every event as a line of JSON.")
@service_options
def follow(job_id: str, as_json: bool, url: str, token: str | None) -> None:
    """Tell job ID's progress as it happens, until it ends."""
    from service.client.display import summary

    with connected(url, token) as client:
        for job in client.job(job_id).follow():
            click.echo(json.dumps(job.view) if as_json else summary(job), err=not as_json)


@click.command()
@click.argument("job_id", metavar="ID")
@click.option("--xi", type=float, help="Take the nearest ξ of the grid.")
@click.option("--direction", type=click.Choice(["up", "down"]), help="Which way, after a ramp both ways.")
@click.option("--every", type=click.IntRange(min=1), help="Take every n-th value of both axes only.")
@click.option("--format", type=click.Choice(TABLES), help="What to write.  [default: the ending of FILE]")
@output_option
@service_options
def modes(
    job_id: str,
    xi: float | None,
    direction: str | None,
    every: int | None,
    format: str | None,
    output: str,
    url: str,
    token: str | None,
) -> None:
    """Write job ID's mode map over Γ and Ω, as csv or json."""
    chosen = format_of(output, TABLES, format)
    with connected(url, token) as client:
        found = client.job(job_id).modes(xi, direction, every=every)
    write_file(output, _map_as_json(found) if chosen == "json" else _map_as_csv(found))


@click.command()
@click.argument("job_id", metavar="ID")
@click.option("-o", "--output", type=click.Path(dir_okay=False), required=True,
              help="File to write, .nc or .parquet.")  # fmt: skip
@service_options
def export(job_id: str, output: str, url: str, token: str | None) -> None:
    """Write all of job ID as one file, NetCDF or Parquet.

    NetCDF (.nc) holds the store's arrays, Parquet (.parquet) a row for every cell.
    """
    format_of(output, FILES)
    with connected(url, token) as client:
        job = client.job(job_id)
        job.export(Path(output))
    if job.state != "done":
        click.echo(f"the job is {job.state} at {job.progress.whole_percent}%: cells are missing", err=True)


@click.command()
@click.option("--gamma", type=float, required=True, help="Γ")
@click.option("--omega", type=float, required=True, help="Ω")
@click.option("--xi", type=float, required=True, help="ξ")
@click.option("--model", default="soft", show_default=True, help="Kind of contact.")
@click.option("--restitution", type=float, help="Of the contact.")
@click.option("--penetration", type=float, help="Of a soft contact, in plate amplitudes.")
@click.option("--settle", type=int, help="Plate periods before the first sample.  [default: 200]")
@click.option("--periods", type=int, help="Plate periods to show.  [default: 4]")
@click.option("--samples", type=int, help="Samples in a period.  [default: 200]")
@click.option("--format", type=click.Choice(TABLES), help="What to write.  [default: the ending of FILE]")
@output_option
@service_options
def trajectory(
    model: str,
    restitution: float | None,
    penetration: float | None,
    format: str | None,
    output: str,
    url: str,
    token: str | None,
    **cell: Any,
) -> None:
    """Write the motion of one cell, sample by sample, as csv or json.

    Lengths are in plate amplitudes. For example:

      bounce trajectory --gamma 2.3 --omega 0.5 --xi 0.26 -o motion.csv
    """
    chosen = format_of(output, TABLES, format)
    contact = {"kind": model, "restitution": restitution, "penetration": penetration}
    given = {name: value for name, value in cell.items() if value is not None}
    given["model"] = {name: value for name, value in contact.items() if value is not None}
    with connected(url, token) as client:
        found = client.trajectory(given)
    write_file(output, _motion_as_json(found) if chosen == "json" else _motion_as_csv(found))


@click.command()
@service_options
def metrics(url: str, token: str | None) -> None:
    """Print the service's figures, in Prometheus's text form."""
    with connected(url, token) as client:
        click.echo(client.metrics(), nl=False)


COMMANDS: Final = (resume, delete, follow, modes, export, trajectory, metrics)


def _map_as_csv(found: "xarray.Dataset") -> bytes:
    """A row for every cell."""
    outcomes = found.outcome.attrs["flag_meanings"].split()
    omega, gamma = found.omega.values.tolist(), found.gamma.values.tolist()
    planes = [found[name].values.tolist() for name in ("outcome", "bounces", "periods")]
    rows = (
        (omega[i], gamma[k], outcomes[planes[0][i][k]], planes[1][i][k], planes[2][i][k])
        for i in range(len(omega))
        for k in range(len(gamma))
    )
    return _table(("omega", "gamma", "outcome", "bounces", "periods"), rows)


def _map_as_json(found: "xarray.Dataset") -> bytes:
    names = ("omega", "gamma", "outcome", "bounces", "periods")
    plain = {"xi": float(found.xi), "direction": str(found.direction.values)}
    plain |= {name: found[name].values.tolist() for name in names}
    return json.dumps({**plain, "complete": bool(found.attrs["complete"])}).encode()


_SAMPLES: Final = ("phase", "plate", "z1", "z2", "force", "in_flight")


def _motion_as_csv(found: "xarray.Dataset") -> bytes:
    columns = [found[name].values.astype(float).tolist() for name in _SAMPLES]
    return _table(_SAMPLES, zip(*columns, strict=True))


def _motion_as_json(found: "xarray.Dataset") -> bytes:
    flights = {name: found[name].values.tolist() for name in ("takeoff", "takeoff_phase", "flight_time")}
    samples = {name: _plain(found[name].values.tolist()) for name in _SAMPLES}
    about = {"rest_length": found.attrs["rest_length"], "complete": bool(found.attrs["complete"])}
    return json.dumps({**about, **samples, "flights": flights}).encode()


def _plain(values: list[float]) -> list[float | None]:
    """null for NaN, which JSON has not."""
    return [value if value == value else None for value in values]  # noqa: PLR0124


def _table(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    table.writerows(rows)
    return text.getvalue().encode()
