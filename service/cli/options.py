"""What the commands of `bounce` have in common: how they fail, and the options several of them take."""

import errno
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import click

if TYPE_CHECKING:
    from service.client import Client

AXES: Final = ("gamma", "omega", "xi")
DEFAULT_URL: Final = "http://127.0.0.1:8000"

Command = TypeVar("Command", bound=Callable[..., None])


class Bounce(click.Group):
    """A group whose commands end with one line on standard error and exit code 1, never with a traceback."""

    def invoke(self, ctx: click.Context) -> object:
        """Run the command; errors raised on purpose and those of the file system become messages."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            message = _message(error)
            if message is None:
                raise
            raise click.ClickException(message) from error


def service_options(command: Command) -> Command:
    """The options that say which service to speak to."""
    return _with(
        command,
        click.option("--url", help="Where the service listens.", default=DEFAULT_URL,
                     show_default=True, envvar="BOUNCE_URL", show_envvar=True),
        click.option("--token", help="What it asks for, if it does.", envvar="BOUNCE_TOKEN",
                     show_envvar=True),
    )  # fmt: skip


def line_options(command: Command) -> Command:
    """The options that choose one line of the grid."""
    return _with(
        command,
        click.option("--along", type=click.Choice(AXES), default="gamma", show_default=True,
                     help="The axis to go along."),
        click.option("--gamma", type=float, help="Take the nearest Γ of the grid."),
        click.option("--omega", type=float, help="Take the nearest Ω of the grid."),
        click.option("--xi", type=float, help="Take the nearest ξ of the grid."),
        click.option("--direction", type=click.Choice(["up", "down"]),
                     help="Which way, after a ramp both ways."),
        click.option("--min-flight", type=float, help="Leave out flights shorter than this, in rad."),
        click.option("--every", type=click.IntRange(min=1), help="Take every n-th cell only."),
    )  # fmt: skip


def output_option(command: Command) -> Command:
    """The option that says where to write."""
    return _with(
        command,
        click.option("-o", "--output", type=click.Path(dir_okay=False, allow_dash=True), required=True,
                     help="File to write; - writes to standard output."),
    )  # fmt: skip


def connected(url: str, token: str | None) -> "Client":
    """A client of the service that was named."""
    from service.client import Client

    return Client(url, token)


def format_of(output: str, formats: tuple[str, ...], chosen: str | None = None) -> str:
    """The format chosen, or the one a file's ending asks for; checked, like its folder, before any work."""
    ending = chosen or Path(output).suffix.lower().removeprefix(".")
    if ending not in formats:
        raise click.BadParameter(
            f"{output!r} does not end in {', '.join('.' + name for name in formats)}", param_hint="'-o'"
        )
    if not Path(output).parent.is_dir():
        raise click.BadParameter(f"there is no folder {Path(output).parent}", param_hint="'-o'")
    return ending


def write_file(output: str, content: bytes) -> None:
    """Write a file whole or not at all: what was there stays until the new content is complete.

    What is no file, like a pipe or /dev/null, is written to and not replaced.
    """
    path = Path(output)
    whole = output != "-" and (path.is_file() or not path.exists())
    with click.open_file(output, "wb", atomic=whole) as file:
        file.write(content)


def _with(command: Command, *options: Callable[[Command], Command]) -> Command:
    """The command with these options, listed by its help in this order."""
    for option in reversed(options):
        command = option(command)
    return command


def _message(error: Exception) -> str | None:
    """What a user should read; None for what is a defect, or a reader of a pipe that has gone."""
    from service.client.errors import BounceError

    if isinstance(error, BounceError):
        return str(error)
    if isinstance(error, OSError) and error.errno != errno.EPIPE:
        reason = error.strerror or str(error)
        return f"{error.filename}: {reason}" if error.filename else reason
    return None
