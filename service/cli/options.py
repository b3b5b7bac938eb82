"""Error messages, common options and output files of the commands of `bounce`."""

import errno
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from functools import wraps
from inspect import cleandoc
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from service.errors import missing_library
from service.formats import seconds_of
from service.tokens import DEFAULT_URL, default_url

if TYPE_CHECKING:
    from service.client import Client

#: When this process imported this module, early: the budget of a command counts from here.
BEGAN: Final = time.monotonic()

#: Seconds that the completion of an id waits for the service.
COMPLETION_SECONDS: Final = 2.0

Command = TypeVar("Command", bound=Callable[..., None])


def seconds(text: str) -> float:
    """The seconds of a time such as 5m."""
    try:
        return seconds_of(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def plural(number: int, thing: str) -> str:
    """A number of things: `1 job`, `2 jobs`."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"


class Number(click.FloatRange):
    """A number within bounds, called so in messages."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if not isfinite(number):  # NaN is within any bounds
            self.fail(f"must be finite, not {value}", param, ctx)
        return number


#: A number, called so in messages and help.
NUMBER: Final = click.types.FloatParamType()
NUMBER.name = "number"


def day(text: str) -> str:
    """A day, or a time of it, as 2026-11-25."""
    try:
        return datetime.fromisoformat(text).isoformat()
    except ValueError:
        raise click.BadParameter(f"must be a day such as 2026-11-25, not {text!r}") from None


class CommandGroup(click.Group):
    """A group whose commands report an error as one message on standard error and exit code 1."""

    _groups: "Mapping[str, Mapping[str, str]]" = {}  # noqa: RUF012 - replaced, never changed

    def arrange(self, groups: "Mapping[str, Mapping[str, str]]") -> None:
        """List the commands in these groups, and put the example of each below the head of its help."""
        self._groups = groups
        for name, example in chain.from_iterable(group.items() for group in groups.values()):
            command = self.commands[name]
            head, _, rest = cleandoc(command.help or "").partition("\n\n")
            shown = f"bounce {name} {example}".rstrip()
            command.help = f"{head}\n\n\b\n  {shown}\n\n{rest}"

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Called by click."""
        for heading, names in self._groups.items():
            with formatter.section(heading):
                formatter.write_dl([(name, self.commands[name].get_short_help_str(80)) for name in names])

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the arguments, or print the help."""
        with _messages():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        """Run the command."""
        with _messages():
            return super().invoke(ctx)


@contextmanager
def _messages() -> Iterator[None]:
    """Exceptions raised on purpose and those of the file system become messages."""
    try:
        yield
    except Exception as error:
        message = _message(error)
        if message is None:
            raise
        raise click.ClickException(message) from error


def complete_id(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Ids of the service's jobs that begin so, with their states and names; none if it does not answer."""
    from service.client import BounceError, Client

    service = ctx.params.get("url"), ctx.params.get("token")
    try:
        with Client(*service, timeout=COMPLETION_SECONDS) as client:
            matching = client.jobs(search=incomplete or None)
            jobs = [job for job in matching if job.id.startswith(incomplete)]
    except BounceError:
        return []
    return [CompletionItem(job.id, help=f"{job.state} {job.name}".rstrip()) for job in jobs]


job_argument = click.argument("job_id", metavar="ID", shell_complete=complete_id)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
data_option = click.option(
    "--data",
    type=click.Path(file_okay=False),
    help="Folder for the job ledger and the stores.  [default: ./bounce-data]",
)


url_option = click.option(
    "--url",
    help="Address of the service.",
    default=default_url,
    show_default=f"the service on ./bounce-data or BOUNCE_DATA; {DEFAULT_URL}",
    envvar="BOUNCE_URL",
    show_envvar=True,
)
token_option = click.option(
    "--token", help="Access token, if the service requires one.", envvar="BOUNCE_TOKEN", show_envvar=True
)


def with_client(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that select the service, and a client of it as its first argument."""

    @wraps(function)
    def run(url: str, token: str | None, **options: Any) -> None:
        from service.client import Client

        with Client(url, token) as client:
            function(client, **options)

    return url_option(token_option(run))


def with_job(function: Callable[..., None]) -> Callable[..., None]:
    """As `with_client`, with the job that the argument ID names in place of the client."""

    @wraps(function)
    def run(client: "Client", job_id: str, **options: Any) -> None:
        function(client.job(job_id), **options)

    return job_argument(with_client(run))


def names_url() -> bool:
    """Whether the command line of the running command has the option --url."""
    return click.get_current_context().get_parameter_source("url") is ParameterSource.COMMANDLINE


def format_option(*formats: str) -> Callable[[Command], Command]:
    """The option that selects the format of the output file."""
    return click.option(
        "--format", type=click.Choice(formats), help="Format of the output.  [default: the ending of FILE]"
    )


def output_format(output: str, formats: tuple[str, ...], format: str | None = None) -> str:
    """`format`, or the one that the ending of the output file stands for.

    Raises click.BadParameter, before anything is computed, for any other ending, for a folder, and for a
    file in a folder that does not exist.
    """
    if output == "-" and format is None:
        asks = click.get_current_context().params.get("format", "") is None
        rule = f"- needs --format: {', '.join(formats)}" if asks else "must be a file"
        raise click.BadParameter(rule, param_hint="'-o'")
    ending = format or Path(output).suffix.lower().removeprefix(".")
    if ending not in formats:
        raise click.BadParameter(
            f"{format or output!r} does not end in {', '.join('.' + x for x in formats)}", param_hint="'-o'"
        )
    if not Path(output).parent.is_dir():
        raise click.BadParameter(f"there is no folder {Path(output).parent}", param_hint="'-o'")
    if ending != "zarr" and Path(output).is_dir():
        raise click.BadParameter(f"{output} is a folder", param_hint="'-o'")
    return ending


def write_file(output: str, content: bytes) -> None:
    """Write a file completely or not at all: an existing file is replaced once the new content is complete.

    A symbolic link is replaced, and what it points to is left alone. A pipe or a device is written to.
    """
    from worker.files import complete_file

    with click.open_file("-", "wb") if output == "-" else complete_file(Path(output)) as file:
        file.write(content)


def _message(error: Exception) -> str | None:
    """The message for the user; None for a defect, or for a closed pipe, which click handles."""
    from worker.kernel_cache import CacheRefused
    from worker.spec.errors import BounceError

    if isinstance(error, BounceError | CacheRefused):
        return str(error)
    if isinstance(error, ModuleNotFoundError) and (missing := missing_library(error)):
        return missing
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "new thread" in str(error)):
        return ": ".join(filter(None, ("not enough memory or threads", str(error))))
    unloaded = isinstance(error, ImportError) and str(error.path).endswith(".so")
    if unloaded or (isinstance(error, OSError) and not error.filename and "shared object" in str(error)):
        return f"a library cannot be loaded, for lack of memory or because it is broken: {error}"
    if isinstance(error, OSError) and error.errno != errno.EPIPE:
        reason = error.strerror or str(error)
        path = error.filename2 or error.filename  # the target of a renaming
        return f"{path}: {reason}" if path else reason
    return None
