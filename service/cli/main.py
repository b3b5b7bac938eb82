"""The command `bounce`: its group, the commands on the service itself, and all other commands registered.

Modules that take long to import are imported by the commands that need them.
"""

from typing import TYPE_CHECKING, Final

import click

from service.cli import data, jobs, views
from service.cli.figure import figure, tradeoff
from service.cli.options import CommandGroup, data_option, with_client
from service.tokens import AUTO, data_folder
from worker.files import complete_file

if TYPE_CHECKING:
    from service.client import Client


@click.group(
    cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(package_name="bouncing-spring")
def main() -> None:
    """Bifurcation diagrams of the bouncing spring over Γ × Ω × ξ.

    Start a service with "bounce serve", submit sweeps with "bounce submit", and draw the results with
    "bounce diagram". "bounce figure 2" does all of this for one figure of the paper.
    """


@main.command()
@click.option("--host", help="Address to listen on.  [default: 127.0.0.1]")
@click.option("--port", type=int, help="Port to listen on; 0 selects a free one.  [default: 8000]")
@data_option
@click.option("--workers", type=int, help="Processes of the embedded cluster.  [default: 2]")
@click.option("--scheduler", help="Address of a Dask scheduler to use instead of an embedded cluster.")
@click.option("--scheduler-file", type=click.Path(), help="File with the address of a Dask scheduler.")
@click.option("--cluster", metavar="MODULE:FUNCTION", help="Function that creates the Dask cluster to use.")
@click.option("--token", type=click.Choice([AUTO]), help="Make an access token that your own clients find. "
              "Set one of your own as BOUNCE_TOKEN: others can see the options of a command.")  # fmt: skip
@click.option("--token-file", type=click.Path(), help="File of access tokens, one NAME: TOKEN per line.")
def serve(**options: str | int | None) -> None:
    """Run the service until SIGINT or SIGTERM.

    Every option can also be set as BOUNCE_HOST, BOUNCE_PORT and so on. On a machine with other users, use
    --token auto. To listen on an address that other machines can reach, set BOUNCE_TOKEN to an access token
    of 16 characters or more, or give a file of tokens.
    """
    from worker.kernel_cache import use_cache

    use_cache()
    from service.server import embedded
    from service.settings import read_settings

    embedded.serve(read_settings(**options), click.echo)


@main.command("open")
@click.option("--print", "print_only", is_flag=True, help="Print the address, with the token, instead.")
@with_client
def open_page(client: "Client", print_only: bool) -> None:
    """Open the page in a browser.

    The access token of a service with --token auto is filled in.
    """
    import webbrowser

    if print_only or not webbrowser.open(_handed_over(client.page)):
        click.echo(client.page)


def _handed_over(address: str) -> str:
    """The address of a file that leads to `address`: all users can see the options of a browser's process."""
    from html import escape

    if "#" not in address:
        return address
    folder = data_folder().absolute()
    if not folder.is_dir():
        raise click.ClickException(f"there is no folder {folder}: use --print, or set BOUNCE_DATA")
    file = folder / "open.html"
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={escape(address)}">'
    with complete_file(file, private=True) as written:
        written.write(page.encode())
    return file.as_uri()


#: The commands in groups, in the order of `bounce --help`, with the arguments of an example.
GROUPS: Final = {
    "Sweeps": {
        "submit": "sweep.toml --wait", "plan": "sweep.toml --budget 5m", "run": "sweep.toml -o sweep.zarr",
        "import": "sweep.html", "list": "--state done", "status": "ID", "wait": "ID", "watch": "",
        "cancel": "ID", "resume": "ID", "rename": 'ID "up and down"', "delete": "ID",
    },
    "Results": {
        "diagram": "ID --omega 0.5 -o diagram.png", "modes": "ID -o map.png",
        "difference": "ID --other ID -o difference.png", "basins": "ID -o basin.png",
        "multistability": "ID --omega 0.5", "audit": "ID", "export": "ID -o sweep.nc",
        "share": "ID -o sweep.html", "figure": "2 -o figure-2.png",
    },
    "Closed forms": {
        "threshold": "--omega 0.6 --xi 0.05", "thresholds": "--omega 0.5:0.6:11 --xi 0.04,0.05",
        "orbits": "--omega 0.6 --xi 0.05 -o branches.png",
        "curves": "--xi 0.05 --omega-start 0.58 --omega-stop 0.64",
        "trajectory": "--gamma 2.3 --omega 0.5 --xi 0.26 -o motion.csv",
    },
    "Service": {"serve": "--workers 4", "open": "", "doctor": ""},
    "Upkeep": {
        "backup": "ledger-backup.sqlite", "restore": "ledger-backup.sqlite", "adopt": "--all",
        "tradeoff": "-o tradeoff.png",
    },
}  # fmt: skip

for command in (*views.COMMANDS, *jobs.COMMANDS, *data.COMMANDS, figure, tradeoff):
    main.add_command(command)
main.arrange(GROUPS)
