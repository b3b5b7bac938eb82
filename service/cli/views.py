"""`bounce NAME ID` for every result of a job. Its options are the parameters of the client's method."""

from inspect import cleandoc, signature
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

import click

from service.cli.options import (
    format_option,
    job_argument,
    open_client,
    output_format,
    service_options,
    write_file,
)
from service.cli.results import warn_unless_done
from service.result_methods import ResultMethods

if TYPE_CHECKING:
    import xarray


#: What is printed instead of the rows of a file: of a plane its attractors, not those of every cell.
_PRINTED: Final = {"multistability": "cells"}


def command(name: str, formats: tuple[str, ...], rows: str | None) -> click.Command:
    """The command of one result."""

    def run(
        job_id: str, output: str | None, format: str | None, url: str, token: str | None, **query: Any
    ) -> None:
        file_format = None if output is None else output_format(output, formats, format)
        with open_client(url, token) as client:
            job = client.job(job_id)
            if output is None:
                click.echo(table(job.result(name, **query), _PRINTED.get(name, rows)))
            else:
                write_file(output, job.result_file(name, str(file_format), **query))
        warn_unless_done(job, "the result may be incomplete")

    method = getattr(ResultMethods, name)
    text = cleandoc(method.__doc__).partition("\nParameters\n")[0]
    options = [
        _option(parameter, about.annotation, about.default)
        for parameter, about in signature(method).parameters.items()
        if parameter != "self"
    ]
    output = click.option(
        "-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
        help="File to write; - is standard output.  [default: print a table]",
    )  # fmt: skip
    decorators = [job_argument, *options, format_option(*formats), output, service_options]
    decorated: Any = run
    for decorator in reversed(decorators):
        decorated = decorator(decorated)
    return click.command(name, help=text)(decorated)


def _option(name: str, hint: Any, default: object) -> Any:
    """The service checks bounds."""
    hint, help = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
    kinds = (hint,) if get_origin(hint) is Literal else (get_args(hint) or (hint,))
    option = f"--{name.replace('_', '-')}"
    if kinds[0] is bool:
        flag = f"{option}/--no-{name.replace('_', '-')}" if default is True else option
        return click.option(flag, default=default, help=help)
    choice = click.Choice(get_args(kinds[0])) if get_origin(kinds[0]) is Literal else kinds[0]
    return click.option(option, type=choice, help=help)


def table(found: "xarray.Dataset", rows: str | None) -> str:
    """The rows of a result as columns of text, then its scalars and shares, one line each."""
    from math import isfinite

    lines = []
    if rows is not None:
        dims = {*map(str, found[rows].dims)}
        names = [str(name) for name, v in found.data_vars.items() if v.dims and dims.issuperset(v.dims)]
        frame = found[names].drop_vars([n for n, v in found.coords.items() if not v.dims]).to_dataframe()
        for name in names:
            attrs = found[name].attrs
            if "flag_meanings" in attrs:
                meanings = dict(
                    zip(attrs["flag_values"].tolist(), attrs["flag_meanings"].split(), strict=True)
                )
                frame[name] = frame[name].map(meanings)
        prefixes = tuple(f"{dim}_" for dim in dims)
        frame.columns = [_without(prefixes, str(name)) for name in frame.columns]
        lines.append(frame.reset_index().to_string(index=False, na_rep="-"))
    scalars = {str(name): v.values.item() for name, v in found.variables.items() if not v.dims}
    scalars |= {str(name): value for name, value in found.attrs.items() if isinstance(value, float)}
    lines += [
        f"{name.replace('_', ' ')}  {value:.10g}"
        if isinstance(value, float)
        else f"{name.replace('_', ' ')}  {value}"
        for name, value in scalars.items()
        if not isinstance(value, float) or isfinite(value)
    ]
    return "\n".join(lines)


def _without(prefixes: tuple[str, ...], name: str) -> str:
    return next((name.removeprefix(prefix) for prefix in prefixes if name.startswith(prefix)), name)


COMMANDS: Final = tuple(
    command(name, formats, ResultMethods.ROWS[name]) for name, formats in ResultMethods.FORMATS.items()
)
