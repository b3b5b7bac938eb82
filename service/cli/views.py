"""`bounce NAME ID` for every result of a job, `bounce NAME` for every one of a spring.

Their options are the parameters of the client's methods.
"""

from collections.abc import Sequence
from inspect import Parameter, cleandoc, signature
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

import click

from service.cli.options import (
    format_option,
    job_argument,
    open_client,
    optional_job_argument,
    output_format,
    service_options,
    write_file,
)
from service.cli.results import warn_unless_done
from service.result_methods import ResultMethods, SpringMethods

if TYPE_CHECKING:
    import xarray


#: Digits of numbers in a table: thresholds are refined to 1e-9.
DIGITS: Final = 10


def command(name: str) -> click.Command:
    """The command of one result, of a job, or without an ID of a spring."""
    kinds = [methods for methods in (ResultMethods, SpringMethods) if name in methods.FORMATS]

    def run(
        output: str | None, format: str | None, url: str, token: str | None, job_id: str | None = None,
        **query: Any,
    ) -> None:  # fmt: skip
        of = kinds[-1] if job_id is None else kinds[0]
        missing = [f"--{each}" for each, about in _parameters(of, name).items() if _is_missing(about, query)]
        if missing:
            other = " or the ID of a job" if len(kinds) > 1 else ""
            raise click.UsageError(f"give {' and '.join(missing)}{other}")
        file_format = None if output is None else output_format(output, of.FORMATS[name], format)
        with open_client(url, token) as client:
            job = None if job_id is None else client.job(job_id)
            source = client if job is None else job
            if output is None:
                click.echo(table(source.result(name, **query), of.PRINTED[name]))
            else:
                write_file(output, source.result_file(name, str(file_format), **query))
        if job is not None:
            warn_unless_done(job, "the result may be incomplete")

    texts = (cleandoc(getattr(of, name).__doc__).partition("\n\nReturns a Dataset ")[0] for of in kinds)
    text = "\n\nWithout ID:\n\n".join(texts).replace("\n\n- ", "\n\n\b\n- ")  # lists keep their lines
    parameters = {each: about for of in reversed(kinds) for each, about in _parameters(of, name).items()}
    options = [_option(each, about.annotation, about.default) for each, about in parameters.items()]
    formats = dict.fromkeys(format for of in kinds for format in of.FORMATS[name])
    argument = optional_job_argument if len(kinds) > 1 else job_argument
    output = click.option(
        "-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
        help="File to write; - is standard output.  [default: print a table]",
    )  # fmt: skip
    of_job = [argument] if ResultMethods in kinds else []
    decorators = [*of_job, *options, format_option(*formats), output, service_options]
    decorated: Any = run
    for decorator in reversed(decorators):
        decorated = decorator(decorated)
    return click.command(name, help=text)(decorated)


def _parameters(methods: type[Any], name: str) -> dict[str, Parameter]:
    """Those of the query: a command waits for workers as long as the client does by default."""
    found = signature(getattr(methods, name)).parameters
    return {each: about for each, about in found.items() if each not in ("self", "timeout", "progress")}


def _is_missing(about: Parameter, query: dict[str, Any]) -> bool:
    return about.default is Parameter.empty and query[about.name] is None


def _option(name: str, hint: Any, default: object) -> Any:
    """The service checks bounds, and has the defaults."""
    hint, help = get_args(hint) if get_origin(hint) is Annotated else (hint, "")
    if default not in (None, True, False, Parameter.empty):
        help += f"  [default: {default}]"
    kinds = (hint,) if get_origin(hint) is Literal else (get_args(hint) or (hint,))
    option = f"--{name.replace('_', '-')}"
    if kinds[0] is bool:
        flag = f"{option}/--no-{name.replace('_', '-')}" if default is True else option
        return click.option(flag, is_flag=True, default=None, help=help)
    choice = click.Choice(get_args(kinds[0])) if get_origin(kinds[0]) is Literal else kinds[0]
    return click.option(option, type=choice, help=help)


#: Attributes of every result, which a table leaves out.
_COMMON: Final = ("Conventions", "title", "job", "kernel_version", "release", "comment", "complete")


def table(found: "xarray.Dataset", rows: Sequence[str]) -> str:
    """A table for each variable of `rows`, then the scalars and attributes, one line each.

    Leaves out what has no value: columns, scalars.
    """
    from math import isfinite

    lines = [_rows(found, name) for name in rows]
    scalars = {str(name): v.values.item() for name, v in found.variables.items() if not v.dims}
    scalars |= {name: value for name, value in found.attrs.items() if name not in _COMMON}
    lines += [
        f"{name.replace('_', ' ')}  {value:.{DIGITS}g}"
        if isinstance(value, float)
        else f"{name.replace('_', ' ')}  {value}"
        for name, value in scalars.items()
        if (isfinite(value) if isinstance(value, float) else value != "")
    ]
    return "\n".join(lines)


def _rows(found: "xarray.Dataset", rows: str) -> str:
    """The variables over dimensions of the variable `rows`."""
    from pandas import option_context

    dims = {*map(str, found[rows].dims)}
    names = [str(name) for name, v in found.data_vars.items() if v.dims and dims.issuperset(v.dims)]
    frame = found[names].drop_vars([n for n, v in found.coords.items() if not v.dims]).to_dataframe()
    for name in names:
        attrs = found[name].attrs
        if "flag_values" in attrs:
            meanings = dict(zip(attrs["flag_values"].tolist(), attrs["flag_meanings"].split(), strict=True))
            frame[name] = frame[name].map(meanings)
    prefixes = tuple(f"{dim}_" for dim in dims)
    frame.columns = [_without(prefixes, str(name)) for name in frame.columns]
    if frame.empty:
        return "  ".join([*map(str, frame.index.names), *frame.columns])
    frame = frame.loc[:, [not (each.isna() | (each == "")).all() for _, each in frame.items()]]
    with option_context("display.precision", DIGITS):
        return frame.reset_index().to_string(index=False, na_rep="-")


def _without(prefixes: tuple[str, ...], name: str) -> str:
    return next((name.removeprefix(prefix) for prefix in prefixes if name.startswith(prefix)), name)


COMMANDS: Final = tuple(map(command, dict.fromkeys([*ResultMethods.FORMATS, *SpringMethods.FORMATS])))
