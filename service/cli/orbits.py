"""The commands on cycles in closed form: orbits and curves, as tables, csv or json."""

import csv
import json
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import click

from service.cli.options import (
    format_option,
    open_client,
    optional_job_argument,
    output_format,
    service_options,
    write_file,
)
from service.formats import TABLES

if TYPE_CHECKING:
    import xarray

output_option = click.option(
    "-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
    help="File to write; - is standard output.  [default: print a table of the events]",
)  # fmt: skip
modes_option = click.option(
    "--modes", default="1-1,1-2", show_default=True, help="Modes, bounces-periods, of one bounce."
)
gamma_max_option = click.option(
    "--gamma-max", type=float, help="Branches are cut above this Γ.  [default: 8]"
)


@click.command()
@optional_job_argument
@click.option("--omega", type=float, help="Ω; of a job, the nearest grid value is used.")
@click.option("--xi", type=float, help="ξ; of a job, the nearest grid value is used.")
@modes_option
@gamma_max_option
@click.option("--points", type=int, help="Points of each branch, at least.  [default: 400]")
@click.option("--direction", type=click.Choice(["up", "down"]), help="Of a job ramped both ways.")
@format_option(*TABLES)
@output_option
@service_options
def orbits(
    job_id: str | None,
    omega: float | None,
    xi: float | None,
    modes: str,
    gamma_max: float | None,
    points: int | None,
    direction: str | None,
    format: str | None,
    output: str | None,
    url: str,
    token: str | None,
) -> None:
    """Compute branches of cycles and their events.

    Stable and unstable ones.

    Without ID, cycles of one bounce at one Ω and ξ, in closed form. With the ID of a sweep, the cycles of
    any number of bounces that its cells along Γ settled to. Prints the events, or writes every point of every
    branch. For example:

      bounce orbits --omega 0.6 --xi 0.05 -o branches.csv
    """
    format = None if output is None else output_format(output, TABLES, format)
    if job_id is None and (omega is None or xi is None):
        raise click.UsageError("give --omega and --xi, or the ID of a sweep")
    with open_client(url, token) as client:
        if job_id is None:
            found = client.orbits(omega or 0.0, xi or 0.0, modes, gamma_max=gamma_max, points=points)
        else:
            found = client.job(job_id).orbits(omega, xi, direction, gamma_max=gamma_max)
    _write(found, "branch", format, output)
    for gamma, reason in zip(_column(found, "skipped_gamma"), _column(found, "skipped_reason"), strict=True):
        click.echo(f"no branch from the cell at gamma {gamma:g}: {reason}", err=True)


@click.command()
@click.option("--omega", type=float, help="Ω, for curves over ξ.")
@click.option("--xi", type=float, help="ξ, for curves over Ω.")
@click.option("--start", type=float, required=True, help="Lowest value of the other parameter.")
@click.option("--stop", type=float, required=True, help="Highest value of the other parameter.")
@modes_option
@click.option("--kinds", help="Such as fold,flip.  [default: all]")
@gamma_max_option
@format_option(*TABLES)
@output_option
@service_options
def curves(
    omega: float | None,
    xi: float | None,
    start: float,
    stop: float,
    modes: str,
    kinds: str | None,
    gamma_max: float | None,
    format: str | None,
    output: str | None,
    url: str,
    token: str | None,
) -> None:
    """Compute curves of folds, flips and other events.

    Over Ω at one ξ, or over ξ at one Ω.

    Prints the points at which they meet or turn, or writes every point of every curve. For example:

      bounce curves --xi 0.05 --start 0.55 --stop 0.7 --modes 1-1 -o curves.csv
    """
    format = None if output is None else output_format(output, TABLES, format)
    if (omega is None) == (xi is None):
        raise click.UsageError("give one of --omega and --xi; the curves go over the other")
    with open_client(url, token) as client:
        found = client.curves(
            omega=(start, stop) if omega is None else omega, xi=(start, stop) if xi is None else xi,
            modes=modes, kinds=kinds, gamma_max=gamma_max,
        )  # fmt: skip
    _write(found, "curve", format, output)


COMMANDS: Final = (orbits, curves)


def plain(found: "xarray.Dataset") -> dict[str, Any]:
    """A Dataset as plain values by name, null for what is not finite, complex numbers as their two parts."""
    names = [*found.coords, *found.data_vars]
    return {str(name): _plain(found[name].values.tolist()) for name in names}


def _gamma(value: float) -> str:
    return f"{value:12.9f}" if isfinite(value) else f"{'-':>12}"


def _write(found: "xarray.Dataset", dim: str, format: str | None, output: str | None) -> None:
    """A table of the events on standard output, or a file of the points."""
    if output is None:
        click.echo(_events(found))
    elif format == "json":
        write_file(output, json.dumps(plain(found)).encode())
    else:
        write_file(output, _csv(found, dim))


def _events(found: "xarray.Dataset") -> str:
    """The events as a table, one per line."""
    names = ("kind", "bounces", "periods", "gamma", "omega", "xi", "flight_time", "admissible")
    columns = [found[f"event_{name}"].values.tolist() for name in names]
    rows = [
        (
            kind,
            f"({bounces},{periods})",
            *(f"{value:.10f}" for value in numbers),
            "no" if reason else "yes",
        )
        for kind, bounces, periods, *numbers, reason in zip(*columns, strict=True)
    ]
    titles = ("EVENT", "MODE", "GAMMA", "OMEGA", "XI", "FLIGHT TIME", "ADMISSIBLE")
    return _table([titles, *rows])


def _table(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def _csv(found: "xarray.Dataset", dim: str) -> bytes:
    """One row per point of every branch or curve: its labels, then what varies along it."""
    labels = [str(name) for name in found.coords if found[name].dims == (dim,)]
    fields = [str(name) for name in found.data_vars if found[name].dims[:2] == (dim, "point")]
    columns = list(_columns(found, fields))
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([dim, *labels, *(name for name, _ in columns)])
    for i in range(found.sizes[dim]):
        own = [found[name].values[i].item() for name in labels]
        rows = zip(*(values[i].tolist() for _, values in columns), strict=True)
        table.writerows([i, *own, *row] for row in _shown(found, i, rows))
    return text.getvalue().encode()


def _shown(found: "xarray.Dataset", i: int, rows: Iterable[Sequence[Any]]) -> Iterator[Sequence[Any]]:
    """The rows of the points that there are."""
    for gamma, row in zip(found.gamma.values[i].tolist(), rows, strict=True):
        if isfinite(gamma):
            yield row


def _columns(found: "xarray.Dataset", fields: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """Name and values (n, points) of every column: one per flight, two for a complex number."""
    for name in fields:
        values = found[name].values
        if values.ndim > 2:
            for flight in range(values.shape[2]):
                yield f"{name}_{flight + 1}", values[:, :, flight]
        elif values.dtype.kind == "c":
            yield f"{name}_re", values.real
            yield f"{name}_im", values.imag
        else:
            yield name, values


def _column(found: "xarray.Dataset", name: str) -> list[Any]:
    values: list[Any] = found[name].values.tolist() if name in found else []
    return values


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    return None if isinstance(value, float) and not isfinite(value) else value
