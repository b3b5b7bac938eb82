"""What the commands of `bounce` have in common: how they fail, and the options several of them take."""

import errno
from collections.abc import Callable
from typing import Final, TypeVar

import click

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
    )  # fmt: skip


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
