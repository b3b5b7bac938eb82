"""The command `bounce`. Whatever takes long to import is imported by the command that needs it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from service.cli import jobs as asking
from service.cli.options import (
    Bounce,
    connected,
    format_of,
    line_options,
    output_option,
    service_options,
    write_file,
)
from service.cli.tradeoff import tradeoff

if TYPE_CHECKING:
    from service.client import Job

#: Seconds that an answer may take while kernels are compiled for the first time.
COMPILING: Final = 300.0
PICTURES: Final = ("png", "svg")
FORMATS: Final = (*PICTURES, "csv", "json")


@click.group(cls=Bounce, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="bouncing-spring")
def main() -> None:
    """Bifurcation diagrams of the bouncing spring over Γ × Ω × ξ.

    Start a service with "bounce serve", hand it sweeps with "bounce submit", and draw what it found with
    "bounce diagram". Or let "bounce figure 2" do all of it for one figure of the paper.
    """


@main.command()
@click.option("--host", help="Address to listen on.  [default: 127.0.0.1]")
@click.option("--port", type=int, help="Port to listen on; 0 takes a free one.  [default: 8000]")
@click.option(
    "--data", type=click.Path(file_okay=False), help="Folder of ledger and stores.  [default: ./bounce-data]"
)
@click.option("--workers", type=int, help="Processes of the embedded cluster.  [default: 2]")
@click.option("--scheduler", help="Address of a Dask scheduler, instead of an embedded cluster.")
@click.option("--scheduler-file", type=click.Path(), help="File in which a Dask scheduler left its address.")
@click.option("--cluster", metavar="MODULE:FUNCTION", help="What makes a Dask cluster, instead of all these.")
def serve(**given: str | int | None) -> None:
    """Run the service until SIGINT or SIGTERM.

    Every option may also be set as BOUNCE_HOST, BOUNCE_PORT and so on. To listen where others can reach
    it, it needs a BOUNCE_TOKEN of 16 characters or more, which callers then have to bring.
    """
    _claim_kernels()
    from service.server import embedded

    embedded.serve(embedded.settings(**given), announce=click.echo)


@main.command()
@click.argument("spec", type=click.Path(exists=True, dir_okay=False, allow_dash=True))
@click.option("--wait", is_flag=True, help="Show progress and return when the job is done.")
@click.option("--estimate", is_flag=True, help="Hand in nothing, only say what it would cost.")
@click.option("--key", help="Idempotency key: the same request again under it changes nothing.")
@service_options
def submit(spec: str, wait: bool, estimate: bool, key: str | None, url: str, token: str | None) -> None:
    """Hand in the sweep in the file SPEC and print its job's id.

    SPEC ends in .json or .toml, or is - for JSON on standard input. The same sweep is the same job: one
    that is done is not computed again, one that failed or was cancelled goes on.
    """
    from service.cli import output as listing
    from service.client.specification import read

    with connected(url, token) as client:
        given = spec if spec != "-" else read(sys.stdin.buffer.read())
        if estimate:
            click.echo(listing.estimate(client.estimate(given)))
            return
        job = client.submit(given, key=key)
        click.echo(job.id)
        if wait:
            _wait(job)


@main.command()
@click.argument("job_id", metavar="ID")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@service_options
def status(job_id: str, as_json: bool, url: str, token: str | None) -> None:
    """Say how far job ID is."""
    from service.cli import output as listing

    with connected(url, token) as client:
        job = client.job(job_id)
        click.echo(listing.as_json(job.view) if as_json else listing.report(job))


@main.command()
@click.argument("job_id", metavar="ID")
@click.option("--timeout", type=click.FloatRange(min=0), help="Give up waiting after so many seconds.")
@service_options
def wait(job_id: str, timeout: float | None, url: str, token: str | None) -> None:
    """Show job ID's progress until it is done.

    The exit code is 0 only if the job succeeded.
    """
    with connected(url, token) as client:
        _wait(client.job(job_id), timeout)


@main.command()
@click.argument("job_id", metavar="ID")
@service_options
def cancel(job_id: str, url: str, token: str | None) -> None:
    """Stop job ID. What it has computed is kept; submitting the same sweep again resumes it."""
    from service.client.display import summary

    with connected(url, token) as client:
        job = client.job(job_id).cancel()
    click.echo(summary(job) if job.finished else f"{summary(job)}: asked to stop", err=True)


@main.command("list")
@click.option(
    "--state", type=click.Choice(["queued", "running", "done", "failed", "cancelled"]), help="Only these."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@service_options
def list_jobs(state: str | None, as_json: bool, url: str, token: str | None) -> None:
    """List the jobs, newest first."""
    from service.cli import output as listing

    with connected(url, token) as client:
        jobs = list(client.jobs(state))
    click.echo(listing.as_json([job.view for job in jobs]) if as_json else listing.table(jobs))


@main.command()
@click.argument("job_id", metavar="ID")
@line_options
@click.option("--format", type=click.Choice(FORMATS), help="What to write.  [default: the ending of FILE]")
@output_option
@service_options
def diagram(job_id: str, output: str, format: str | None, url: str, token: str | None, **line: Any) -> None:
    """Draw job ID's bifurcation diagram along one axis.

    With csv or json, write its points instead. For example:

      bounce diagram ID --along gamma --omega 0.5 --xi 0.26 -o fig.png
    """
    chosen = format_of(output, FORMATS, format)
    with connected(url, token) as client:
        job = client.job(job_id)
        write_file(output, job.picture(format=chosen, **line))
    if job.state != "done":
        click.echo(
            f"the job is {job.state} at {job.progress.whole_percent}%: the diagram is incomplete", err=True
        )


@main.command()
@click.argument("job_id", metavar="ID")
@click.option("--xi", type=float, help="Take the nearest ξ of the grid.")
@click.option("--tolerance", type=float, help="In Γ: refine beyond the grid, from the job's stored states.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@service_options
def threshold(
    job_id: str, xi: float | None, tolerance: float | None, as_json: bool, url: str, token: str | None
) -> None:
    """Say where bouncing begins and ends in job ID, per Ω.

    The job is a sweep from rest or ramped along gamma. Each Γ is the lowest that bounces.
    """
    from service.cli import output as listing

    with connected(url, token) as client:
        found = client.job(job_id).threshold(xi, tolerance=tolerance)
    click.echo(listing.as_json(listing.thresholds_view(found)) if as_json else listing.thresholds(found))


@main.command()
@click.argument("number", metavar="N|all")
@click.option("-o", "--output", type=click.Path(allow_dash=True),
              help="File, .png or .svg; for all, a folder.  [default: figure-N.png; figures]")  # fmt: skip
@click.option("--format", type=click.Choice(PICTURES), default="png", show_default=True,
              help="What to write into a folder.")  # fmt: skip
@click.option(
    "--data", type=click.Path(file_okay=False), help="Folder of ledger and stores.  [default: ./bounce-data]"
)
@click.option("--workers", type=int, help="Processes of the embedded cluster.  [default: 2]")
@click.option("--url", help="Use the service that listens here instead of an embedded one.")
@click.option("--token", envvar="BOUNCE_TOKEN", help="What that service asks for, if it does.")
def figure(
    number: str,
    output: str | None,
    format: str,
    url: str | None,
    token: str | None,
    **given: str | int | None,
) -> None:
    """Make figure N of the paper, or all of them, start to end.

    Starts a service of its own with two worker processes, hands it the figures' sweeps, draws what it
    found, and says what agrees with the paper. A second run finds the finished jobs in the data folder and
    only draws.
    """
    from service.client import Client
    from service.figures import catalogue

    wanted = catalogue.figures(number)
    if number == "all":
        folder = Path(output or "figures")
        folder.mkdir(parents=True, exist_ok=True)
        targets = [str(folder / f"figure-{one.number}.{format}") for one in wanted]
    else:
        targets = [output or f"figure-{number}.{format}"]
        format = format_of(targets[0], PICTURES)
    with _service(url, given) as address, Client(address, token, timeout=COMPILING) as client:
        for target, picture in zip(targets, catalogue.make(wanted, client, format), strict=True):
            write_file(target, picture.content)
            click.echo(f"{target}\n{picture.caption}\n", err=True)


@contextmanager
def _service(url: str | None, given: dict[str, str | int | None]) -> Iterator[str]:
    """The address of the service that was named, or of one that lives as long as this block."""
    if url is not None:
        yield url
        return
    _claim_kernels()
    from service.server import embedded

    click.echo("starting a service and its workers (the first time, a minute to compile)", err=True)
    with embedded.running(embedded.settings(**given, host="127.0.0.1", port=0)) as address:
        yield address


def _claim_kernels() -> None:
    """Give this process a cache of compiled kernels, before anything that declares them is imported."""
    from worker.kernel_cache import claim_cache

    claim_cache()


def _wait(job: "Job", timeout: float | None = None) -> None:
    try:
        job.wait(timeout=timeout)
    except KeyboardInterrupt:
        click.echo(f"stopped waiting; the job goes on (stop it with: bounce cancel {job.id})", err=True)
        sys.exit(130)


for command in (*asking.COMMANDS, tradeoff):
    main.add_command(command)


if __name__ == "__main__":
    main()
