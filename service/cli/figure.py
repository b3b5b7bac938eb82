"""The commands that make pictures without a running service: figure, tradeoff."""

import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

import click

from service.cli import options
from service.formats import PICTURES
from service.tokens import AUTO, data_folder, find_service, find_token

#: Seconds for one answer: the first trajectory waits until the kernels are compiled.
COMPILE_SECONDS: Final = 300.0


@click.command()
@click.argument("number", metavar="N|all")
@click.option("-o", "--output", type=click.Path(allow_dash=True),
              help="A png, svg or pdf; for all, a folder.  [default: figure-N.png; figures]")  # fmt: skip
@click.option("--format", type=click.Choice(PICTURES), default="png", show_default=True,
              help="Format of the files in the folder.")  # fmt: skip
@options.data_option
@click.option("--workers", type=int, help="Worker processes of the local service.  [default: 2]")
@click.option("--url", help="Use the running service at this address instead of a local one.",
              envvar="BOUNCE_URL", show_envvar=True)  # fmt: skip
@options.token_option
def figure(
    number: str,
    output: str | None,
    format: str,
    data: str | None,
    workers: int | None,
    url: str | None,
    token: str | None,
) -> None:
    """Make figure N of the paper, or all, from start to end.

    Starts a local service with two worker processes, submits the sweeps of the figures, draws the results and
    prints how they compare with the paper. A second run finds the finished jobs in the data folder and only
    draws. If a service runs on the data folder, that service is used.
    """
    from service.client import Client
    from service.figures import catalogue

    if data is not None and options.names_url():
        raise click.UsageError("--data names the folder of a local service, --url another service: give one")
    figures = catalogue.figures(number)
    if number == "all":
        if output == "-" or Path(output or "").suffix.removeprefix(".") in PICTURES:
            raise click.BadParameter("must be a folder, for all figures", param_hint="'-o'")
        folder = Path(output or "figures")
        folder.mkdir(parents=True, exist_ok=True)
        targets = [str(folder / f"figure-{figure.number}.{format}") for figure in figures]
    else:
        targets = [output or f"figure-{number}.{format}"]
        format = options.output_format(targets[0], PICTURES)
    with ExitStack() as stack:
        if url is None or data is not None:
            url, token = stack.enter_context(_service(workers, data, token))
        client = stack.enter_context(Client(url, token, timeout=COMPILE_SECONDS))
        for target, drawing in zip(targets, catalogue.make(figures, client), strict=True):
            options.write_file(target, drawing.encoded(format))
            click.echo(f"{target}\n{drawing.caption}\n", err=True)


@contextmanager
def _service(workers: int | None, data: str | None, token: str | None) -> Iterator[tuple[str, str | None]]:
    """Address and token of a service with its results in `data`, by default BOUNCE_DATA or ./bounce-data.

    A folder has one service at a time. If `bounce serve` runs on it, that service is used; otherwise one is
    started in this process, with a token of its own, as other users of the machine reach its port too.
    Raises DataFolderBusy if another command uses the folder.
    """
    folder = Path(data) if data else data_folder()
    if (url := find_service(folder)) is not None:
        click.echo(f"using the service at {url}, which runs on {folder}", err=True)
        yield url, find_token(urlsplit(url).port or 80, folder) if token in (None, "", AUTO) else token
        return
    from service.client.display import display_elapsed
    from worker.kernel_cache import use_cache

    use_cache()
    from service.server import embedded
    from service.settings import read_settings

    token = secrets.token_urlsafe()
    settings = read_settings(workers=workers, data=data, host="127.0.0.1", port=0, token=token)
    with ExitStack() as stack:
        with display_elapsed("starting a local service"):
            url = stack.enter_context(embedded.running(settings))
        yield url, token


@click.command()
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False), help="File to write as well, a picture or a table."
)
def tradeoff(output: str | None) -> None:
    """Measure the cost and the accuracy of each contact model.

    Computes a fixed set of cells, extreme ones included, one after another in this process: some minutes.
    """
    from service.cli.views import table
    from service.client.display import display_elapsed
    from service.figures import tradeoff
    from service.views.encode import check_format
    from service.views.registry import encoded
    from worker.kernel_cache import use_cache

    if output:
        format = options.output_format(output, tradeoff.VIEW.formats)
        check_format(format)
    use_cache()
    measured = [0]
    with display_elapsed(lambda: f"measured {measured[-1]} of {len(tradeoff.SETTINGS)} contacts"):
        results = tradeoff.measure(tradeoff.SETTINGS, measured.append)
    click.echo(table(results, ["cost"]))
    if output:
        options.write_file(output, encoded(tradeoff.VIEW, None, results, format))
