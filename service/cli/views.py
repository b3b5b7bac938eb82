"""The commands on results: `bounce NAME ID` for results of a job, `bounce NAME` for results of a spring.

Their options are the parameters of the client's methods. Also export, share and trajectory.
"""

import json
from collections.abc import Callable, Sequence
from inspect import Parameter, cleandoc, signature
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

import click

from service.cli import options
from service.formats import EXPORTS, PICTURES, DatasetFormat, ExportLayout, Methods
from service.result_methods import ResultMethods, SpringMethods

if TYPE_CHECKING:
    import xarray
    from pandas import DataFrame

    from service.client import Client, Job


_MOTIONS: Final = get_args(DatasetFormat)

#: Results over which measured points are drawn.
MEASURED: Final = ("diagram", "threshold")
measured_points = click.option(
    "--data", type=click.Path(exists=True, dir_okay=False),
    help="CSV file of measured points, drawn over a picture: gamma or omega, flight_time in rad or "
    "flight_time_ms and frequency in Hz (over thresholds omega and gamma), perhaps error.",
)  # fmt: skip
#: Digits of numbers in a table, fewer in a wide one: thresholds are refined to 1e-9.
DIGITS: Final = 10
#: Limits on the characters of a line of a table and of a text in it, and on the points of a curve.
WIDTH: Final = 100
LONG: Final = 40
POINTS: Final = 12


def command(name: str) -> click.Command:
    """The command of one result: of a job, or without an ID of a spring."""
    kinds = [methods for methods in (ResultMethods, SpringMethods) if name in methods.RESULTS]

    def run(
        client: "Client", output: str | None, format: str | None, job_id: str | None = None,
        data: str | None = None, **query: Any,
    ) -> None:  # fmt: skip
        output = output or (format and "-")
        methods = kinds[-1] if job_id is None else kinds[0]
        parameters = _parameters(methods, name)
        required = (field for field, about in parameters.items() if about.default is Parameter.empty)
        if missing := [_option_name(field) for field in required if query[field] is None]:
            other = " or the ID of a job" if len(kinds) > 1 else ""
            raise click.UsageError(f"give {' and '.join(missing)}{other}")
        for field, value in query.items():
            if value is not None and field not in parameters:
                where = "without the ID of a job" if job_id else "with the ID of a job"
                similar = [_option_name(other) for other in parameters if field in other]
                hint = f"; give {' and '.join(similar)}" if similar else ""
                raise click.UsageError(f"{_option_name(field)} is only {where}{hint}")
        formats, printed = methods.RESULTS[name]
        file_format = None if output is None else options.output_format(output, formats, format)
        if data is not None and (job_id is None or file_format not in PICTURES):
            raise click.UsageError(f"--data needs the ID of a job, and -o with one of {', '.join(PICTURES)}")
        job = None if job_id is None else client.job(job_id)
        source = client if job is None else job
        if "other" in query:
            query["other"] = client.job(query["other"]).id
        if output is None:
            click.echo(table(source.result(name, **query), printed))
        elif job is not None and data is not None:
            options.write_file(output, _picture(job, name, data, str(file_format), query))
        else:
            options.write_file(output, source.result_file(name, str(file_format), **query))
        if job is not None:
            _warn_unless_done(job, "the result may be incomplete")

    texts = (cleandoc(getattr(kind, name).__doc__).partition("\n\nReturns a Dataset ")[0] for kind in kinds)
    text = "\n\nWithout ID:\n\n".join(texts).replace("\n\n- ", "\n\n\b\n- ")  # lists keep their lines
    every_format = dict.fromkeys(format for kind in kinds for format in kind.RESULTS[name][0])
    decorated = options.with_client(run)
    decorated = click.option(
        "-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
        help="File to write; - is standard output.  [default: print a table, or --format]",
    )(decorated)  # fmt: skip
    if name in MEASURED:
        decorated = measured_points(decorated)
    decorated = query_options(*reversed(kinds), name=name)(options.format_option(*every_format)(decorated))
    if ResultMethods in kinds:
        metavar, required = ("ID", True) if len(kinds) == 1 else ("[ID]", False)
        if "other" in _parameters(ResultMethods, name):
            metavar += " --other ID"  # a second ID is an error, which shows this
        argument = click.argument(
            "job_id", metavar=metavar, required=required, shell_complete=options.complete_id
        )
        decorated = argument(decorated)
    return click.command(name, help=text)(decorated)


def _picture(job: "Job", name: str, data: str, format: str, query: dict[str, Any]) -> bytes:
    """A result with measured points over it, drawn here."""
    from service.pictures import draw_caption, metadata

    result, file = job.result(name, **query), BytesIO()
    axes = result.bounce.plot(data=data)
    if "caption" in result.attrs:
        axes.set_title("")
        draw_caption(axes, result)
    origin = {fact: result.attrs[fact] for fact in ("job", "kernel_version", "release")}
    origin["spec"] = json.dumps(job.spec, ensure_ascii=False)
    about = metadata(format, origin)
    axes.get_figure(root=True).savefig(file, format=format, bbox_inches="tight", metadata=about)
    return file.getvalue()


def query_options(*kinds: type[Methods], name: str) -> Callable[[options.Command], options.Command]:
    """The options that are the parameters of a result."""
    parameters = {field: about for kind in kinds for field, about in _parameters(kind, name).items()}

    def decorate(command: options.Command) -> options.Command:
        for field, about in reversed(parameters.items()):
            command = _option(field, about.annotation, about.default)(command)
        return command

    return decorate


def _parameters(methods: type[Methods], name: str) -> dict[str, Parameter]:
    """The parameters of a query: a command waits for workers as long as the client does by default."""
    others = ("self", "timeout", "progress")
    fields = signature(getattr(methods, name)).parameters.items()
    return {field: about for field, about in fields if field not in others}


def _option_name(field: str) -> str:
    return f"--{field.replace('_', '-')}"


def _option(field: str, hint: Any, default: object) -> Any:
    """The option for a parameter. The service checks bounds, and has the defaults."""
    hint, help = get_args(hint) if get_origin(hint) is Annotated else (hint, "")
    if default not in (None, True, False, Parameter.empty):
        help += f"  [default: {default}]"
    kinds = (hint,) if get_origin(hint) is Literal else (get_args(hint) or (hint,))
    option = _option_name(field)
    if kinds[0] is bool:
        flag = f"{option}/{_option_name(f'no-{field}')}" if default is True else option
        return click.option(flag, is_flag=True, default=None, help=help)
    plain = options.NUMBER if kinds[0] is float else kinds[0]
    choice = click.Choice(get_args(kinds[0])) if get_origin(kinds[0]) is Literal else plain
    return click.option(option, type=choice, help=help)


#: Attributes of every result, which a table leaves out.
_COMMON: Final = ("Conventions", "title", "job", "kernel_version", "release", "comment", "complete")


def table(result: "xarray.Dataset", rows: Sequence[str]) -> str:
    """A table for each variable of `rows`, then the scalars with units and attributes, one line each.

    An axis of one value that is in no table is a scalar. Leaves out columns and scalars without a value.
    """
    from math import isfinite

    tables = [name for name in rows if name in result.variables]
    lines = [_rows(result, name) for name in tables]
    others = set(result.indexes).difference(*(result[name].dims for name in tables))
    fixed = result.squeeze([dim for dim in others if result.sizes[dim] == 1])
    scalars = {str(name): v for name, v in fixed.variables.items() if not v.dims}
    values = {name: v.values.item() for name, v in scalars.items()}
    values |= {str(name): value for name, value in result.attrs.items() if name not in _COMMON}
    for name, value in values.items():
        if isfinite(value) if isinstance(value, float) else value != "":
            text = f"{value:.{DIGITS}g}" if isinstance(value, float) else value
            unit = scalars[name].attrs.get("units", "1") if name in scalars else "1"
            lines.append(f"{name.replace('_', ' ')}  {text}{f' {unit}' if unit != '1' else ''}")
    return "\n".join(lines)


def _rows(result: "xarray.Dataset", rows: str) -> str:
    """A table of the variables over the dimensions of `rows`, at most WIDTH wide, with long texts below.

    Shows every n-th point of a curve.
    """
    dims = {*map(str, result[rows].dims)}
    every = -(-result.sizes["point"] // POINTS) if "point" in dims else 1
    frame = _frame(result.isel(point=slice(None, None, every), missing_dims="ignore"), rows, dims)
    if frame.empty:
        return f"{'  '.join([*map(str, frame.index.names), *frame.columns])}: none"
    frame = frame.loc[:, [not (values.isna() | (values == "")).all() for _, values in frame.items()]]
    notes = [f"one point of {every} is shown: -o writes all"] if every > 1 else []
    for column in [str(name) for name, x in frame.items() if x.astype(str).str.len().max() > LONG]:
        texts = frame.pop(column)
        notes += [f"{_place(texts.index.names, index)}: {text}" for index, text in texts.items() if text]
    words = frame.select_dtypes(exclude="number")
    constant = words.columns[(words.nunique() == 1) & (len(frame) > 1)]
    for apart, digits in ((constant[:0], DIGITS), *((constant, digits) for digits in range(DIGITS, 5, -1))):
        lines = _lines(frame.drop(columns=apart), digits)
        if max(map(len, lines)) <= WIDTH:
            break
    notes = [*(f"{name}  {words[name].iloc[0]}" for name in apart), *notes]
    return "\n".join([*lines, *(fill(note, WIDTH, subsequent_indent="  ") for note in notes)])


def _frame(result: "xarray.Dataset", rows: str, dims: set[str]) -> "DataFrame":
    """The variables over `dims`, those of `rows`, with words for flags and a column for each exponent."""
    result = result.reset_coords()
    if "lyapunov" in result and "exponent" not in dims:
        exponents = enumerate(result.lyapunov.transpose("exponent", ...), 1)
        result = result.assign({f"lyapunov_{i}": exponent for i, exponent in exponents})
    names = [str(name) for name, v in result.data_vars.items() if v.dims and dims.issuperset(v.dims)]
    frame = result[names].to_dataframe()
    for name in names:
        if "flag_values" in (attrs := result[name].attrs):
            meanings = dict(zip(attrs["flag_values"].tolist(), attrs["flag_meanings"].split(), strict=True))
            frame[name] = frame[name].map(meanings)
    if len(dims) > 1:
        frame = frame[frame[rows].notna()]
    frame.columns = frame.columns.str.replace(f"^({'|'.join(dims - {'flight'})})_", "", regex=True)
    return frame


def _lines(frame: "DataFrame", digits: int) -> list[str]:
    """The lines of a table. Numbers of its index have as many digits as tell them apart."""
    least = {str(name): _told_apart(frame.index.unique(name)) for name in frame.index.names}
    told = {name: f"{{:.{max(digits, n)}g}}".format for name, n in least.items() if n}
    return frame.reset_index().to_string(
        index=False, na_rep="-", float_format=f"{{:.{digits}g}}".format, formatters=told
    ).splitlines()  # fmt: skip


def _told_apart(values: Any) -> int:
    """The fewest digits that tell numbers from each other; 0 for others."""
    if values.dtype.kind != "f":
        return 0
    return next(digits for digits in range(1, 18) if len({f"{x:.{digits}g}" for x in values}) == len(values))


def _place(names: Sequence[Any], index: Any) -> str:
    """The names and values of an index, such as `gamma 2.5, omega 0.6`."""
    values = index if isinstance(index, tuple) else (index,)
    shown = (f"{value:.6g}" if isinstance(value, float) else str(value) for value in values)
    return ", ".join(f"{name} {value}" for name, value in zip(names, shown, strict=True))


@click.command()
@click.option("-o", "--output", type=click.Path(dir_okay=False), required=True,
              help="File to write, .nc, .parquet or .html.")  # fmt: skip
@click.option(
    "--layout", type=click.Choice(get_args(ExportLayout)), default="cells", show_default=True,
    help="What a row of Parquet is: a cell with lists of its flights, or each flight.",
)  # fmt: skip
@options.job_argument
@options.with_client
def export(client: "Client", job_id: str, output: str, layout: ExportLayout) -> None:
    """Write all results of a job to one file.

    NetCDF (.nc) contains the arrays of the store, Parquet (.parquet) one row per cell, or with --layout
    flights one row per flight. A page (.html) shows a sweep in any browser, without service and network.
    """
    options.output_format(output, EXPORTS)
    job = client.job(job_id)
    job.export(Path(output), layout=layout)
    _warn_unless_done(job, "cells are missing")


@click.command()
@click.option("-o", "--output", type=click.Path(dir_okay=False), required=True, help="File to write, .html.")
@measured_points
@options.job_argument
@options.with_client
def share(client: "Client", job_id: str, output: str, data: str | None) -> None:
    """Write a sweep as a page that needs no service."""
    options.output_format(output, ("html",))
    job = client.job(job_id)
    job.share(Path(output), data)
    _warn_unless_done(job, "cells are missing")


@click.command()
@click.option("--gamma", type=options.NUMBER, required=True, help="Γ")
@click.option("--omega", type=options.NUMBER, required=True, help="Ω")
@click.option("--xi", type=options.NUMBER, required=True, help="ξ")
@click.option("--model", default="soft", show_default=True, help="Contact model.")
@click.option("--restitution", type=options.NUMBER, help="Restitution of the contact.")
@click.option(
    "--penetration", type=options.NUMBER, help="Penetration of a soft contact, in plate amplitudes."
)
@click.option("--settle", type=int, help="Plate periods before the first sample.  [default: 200]")
@click.option("--periods", type=int, help="Plate periods to sample.  [default: 4]")
@click.option("--samples", type=int, help="Samples per plate period.  [default: 200]")
@click.option("--drop", type=(options.NUMBER, options.NUMBER), metavar="HEIGHT PHASE",
              help="Let go at rest at this height (plate amplitudes) and plate phase (rad).")  # fmt: skip
@click.option("--contact", type=(options.NUMBER, options.NUMBER), metavar="ELONGATION VELOCITY",
              help="Start in contact, elongated beyond the static length; velocity × Ω.")  # fmt: skip
@options.format_option(*_MOTIONS)
@click.option("-o", "--output", type=click.Path(dir_okay=False, allow_dash=True), required=True,
              help="File to write; - is standard output.")  # fmt: skip
@options.with_client
def trajectory(
    client: "Client",
    model: str,
    restitution: float | None,
    penetration: float | None,
    drop: tuple[float, float] | None,
    contact: tuple[float, float] | None,
    format: str | None,
    output: str,
    **cell: Any,
) -> None:
    """Write the motion of one cell.

    A row of a table is a sample; lengths are in plate amplitudes.
    """
    format = options.output_format(output, _MOTIONS, format)
    if drop and contact:
        raise click.UsageError("give --drop or --contact, not both")
    if drop:
        cell["start"] = {"kind": "drop", "height": drop[0], "phase": drop[1]}
    if contact:
        cell["start"] = {"kind": "contact", "elongation": contact[0], "velocity": contact[1]}
    cell["model"] = _without_none({"kind": model, "restitution": restitution, "penetration": penetration})
    options.write_file(output, client.trajectory_file(_without_none(cell), format))


#: A trajectory of a cell replaces that of a job.
COMMANDS: Final = (
    *map(command, dict.fromkeys([*ResultMethods.RESULTS, *SpringMethods.RESULTS])),
    export,
    share,
    trajectory,
)


def _warn_unless_done(job: "Job", consequence: str) -> None:
    """Warn on standard error about a job's notice, and about results that are not complete."""
    if job.notice:
        click.echo(f"the job is {job.notice}", err=True)
    if job.state != "done":
        click.echo(f"the job is {job.state} at {job.progress.whole_percent}%: {consequence}", err=True)


def _without_none(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}
