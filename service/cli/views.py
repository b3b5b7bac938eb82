"""`bounce NAME` for every result. Its options are the parameters of the client's method."""

from collections.abc import Mapping, Sequence
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
from service.client.result_methods import ResultMethods, SpringMethods

if TYPE_CHECKING:
    import xarray


def command(name: str) -> click.Command:
    """The command of one result: of a job, of a spring, or with an optional ID of either."""
    kinds = [kind for kind in (SpringMethods, ResultMethods) if name in kind.FORMATS]
    formats = kinds[0].FORMATS[name]
    parameters = {kind: _parameters(getattr(kind, name)) for kind in kinds}
    every = {key: about for own in parameters.values() for key, about in own.items()}

    def run(
        output: str | None,
        format: str | None,
        url: str,
        token: str | None,
        job_id: str | None = None,
        **options: Any,
    ) -> None:
        kind = SpringMethods if job_id is None else ResultMethods
        query = _query(parameters, kind, options)
        file_format = None if output is None else output_format(output, formats, format)
        with open_client(url, token) as client:
            source = client if job_id is None else client.job(job_id)
            if output is None:
                click.echo(table(source.result(name, **query), kind.PRINTED[name]))
            else:
                write_file(output, source.result_file(name, str(file_format), **query))
        if isinstance(source, ResultMethods):
            warn_unless_done(source, "the result may be incomplete")

    texts = [cleandoc(getattr(kind, name).__doc__).partition("\nParameters\n")[0] for kind in kinds]
    options = [_option(key, about.annotation, about.default) for key, about in every.items()]
    output = click.option(
        "-o", "--output", type=click.Path(dir_okay=False, allow_dash=True),
        help="File to write; - is standard output.  [default: print a table]",
    )  # fmt: skip
    argument = optional_job_argument if SpringMethods in kinds else job_argument
    arguments = [argument] if ResultMethods in kinds else []
    decorated: Any = run
    for decorator in reversed([*arguments, *options, format_option(*formats), output, service_options]):
        decorated = decorator(decorated)
    return click.command(name, help="\nWith the ID of a job:\n\n".join(texts))(decorated)


def _parameters(method: Any) -> dict[str, Parameter]:
    """What a method asks the service for; it waits as long as it does by default."""
    others = ("self", "timeout", "progress")
    return {key: about for key, about in signature(method).parameters.items() if key not in others}


def _query(
    kinds: Mapping[Any, Mapping[str, Parameter]], kind: Any, options: dict[str, Any]
) -> dict[str, Any]:
    """The options of this kind of result. Raises click.UsageError for others, and for missing ones."""
    own = kinds[kind]
    others = {
        key: about for parameters in kinds.values() for key, about in parameters.items() if key not in own
    }
    for key, about in others.items():
        if options[key] not in (None, about.default):
            other = "spring: leave out the ID" if kind is ResultMethods else "job: give its ID"
            raise click.UsageError(f"{_flag(key)} is for a {other}")
    missing = [
        _flag(key) for key, about in own.items() if about.default is about.empty and options[key] is None
    ]
    if missing:
        hint = ", or the ID of a job" if len(kinds) > 1 else ""
        raise click.UsageError(f"give {' and '.join(missing)}{hint}")
    return {key: options[key] for key in own}


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _option(name: str, hint: Any, default: object) -> Any:
    """The service checks bounds."""
    hint, help = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
    kinds = (hint,) if get_origin(hint) is Literal else (get_args(hint) or (hint,))
    option = _flag(name)
    if kinds[0] is bool:
        flag = f"{option}/--no{option[1:]}" if default is True else option
        return click.option(flag, is_flag=True, default=default, help=help)
    choice = click.Choice(get_args(kinds[0])) if get_origin(kinds[0]) is Literal else kinds[0]
    return click.option(option, type=choice, help=help)


def table(found: "xarray.Dataset", rows: Sequence[str]) -> str:
    """A table for each variable of `rows`, then the scalars, one line each."""
    from math import isfinite

    lines = [_rows(found, name) for name in rows]
    scalars = {str(name): v.values.item() for name, v in found.variables.items() if not v.dims}
    lines += [
        f"{name.replace('_', ' ')}  {value:.10g}"
        if isinstance(value, float)
        else f"{name.replace('_', ' ')}  {value}"
        for name, value in scalars.items()
        if not isinstance(value, float) or isfinite(value)
    ]
    return "\n".join(lines)


def _rows(found: "xarray.Dataset", rows: str) -> str:
    """The variables over dimensions of the variable `rows`."""
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
    frame = frame.reset_index()
    if not len(frame):
        return "  ".join(frame.columns)
    return frame.to_string(index=False, na_rep="-", float_format="{:.10g}".format)


def _without(prefixes: tuple[str, ...], name: str) -> str:
    return next((name.removeprefix(prefix) for prefix in prefixes if name.startswith(prefix)), name)


COMMANDS: Final = tuple(map(command, {**ResultMethods.FORMATS, **SpringMethods.FORMATS}))
