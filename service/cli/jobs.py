"""The commands on jobs: submit, run, status, wait, watch, cancel, resume, delete, list."""

import json
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

import click

from service.cli.options import (
    BEGAN,
    Number,
    day,
    format_option,
    json_option,
    output_format,
    seconds,
    with_client,
    with_job,
    write_file,
)
from service.cli.views import query_options
from service.formats import EXPORTS, PICTURES, TABLES, DatasetFormat
from service.result_methods import ResultMethods

if TYPE_CHECKING:
    from service.client import Client, Job

STATES: Final = ("queued", "running", "done", "failed", "cancelled")
ORDERS: Final = ("newest", "oldest", "finished", "name", "largest")
_RUN_FORMATS: Final = ("zarr", *EXPORTS, *PICTURES, *TABLES)

_budget_option: Final = click.option(
    "--budget", type=seconds, metavar="TIME",
    help="Compute the finest level that fits into this time: 90s, 5m, 1h.",
)  # fmt: skip
_effort_option: Final = click.option(
    "--effort", type=click.Choice(["draft", "standard", "thorough"]),
    help="Windows of the cells, in place of settle, observe and until.",
)  # fmt: skip


@click.command()
@click.argument("spec", type=click.Path(exists=True, dir_okay=False, allow_dash=True))
@click.option("--wait", "wait_for_job", is_flag=True, help="Show progress and wait until the job is done.")
@click.option("--estimate", is_flag=True, help="Print the estimated cost without submitting.")
@click.option("--key", help="Idempotency key: repeating the request with it changes nothing.")
@_effort_option
@_budget_option
@with_client
def submit(
    client: "Client",
    spec: str,
    wait_for_job: bool,
    estimate: bool,
    key: str | None,
    effort: str | None,
    budget: float | None,
) -> None:
    """Submit a sweep and print its job id.

    SPEC is a .json or .toml file, or - for JSON on standard input. The same sweep is always the same
    job: one that is done is not computed again, one that failed or was cancelled continues.
    With --budget the jobs are levels from coarse to fine; the id is that of the last one that is done.
    """
    from service.cli import output

    for option, given in (("--key", key is not None), ("--estimate", estimate)):
        if budget is not None and given:
            raise click.UsageError(f"{option} is of one job, and --budget submits several: give one")
    specification = _specification(spec, effort)
    if estimate:
        click.echo(output.estimate_line(client.estimate(specification)))
        return
    try:
        within = None if budget is None else client.run(specification, budget=budget)
    except SystemExit:  # by a signal
        click.echo(
            "stopped waiting; levels that the service accepted go on (see them with: bounce list)", err=True
        )
        raise
    job = within or client.submit(specification, key=key)
    click.echo(job.id)
    if wait_for_job:
        _wait(job)


@click.command()
@click.argument("spec", type=click.Path(exists=True, dir_okay=False, allow_dash=True))
@query_options(ResultMethods, name="diagram")
@format_option(*_RUN_FORMATS)
@click.option("-o", "--output", type=click.Path(), required=True, help="File or zarr store to write.")
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads.  [default: one per core]")
@_effort_option
@_budget_option
def run(
    spec: str,
    output: str,
    format: str | None,
    workers: int | None,
    effort: str | None,
    budget: float | None,
    **query: Any,
) -> None:
    """Compute a study without a service, and write it.

    The ending of OUTPUT selects what is written: the study (.zarr, .nc, .parquet), a page that shows it
    (.html), or a picture or table (.png, .svg, .pdf, .csv, .json): the map of a grid over gamma and omega,
    else the diagram, basin, attractors or branches. SPEC is as for "bounce submit". An interrupted run leaves
    the folder OUTPUT.partial, from which the same command continues.

    For a diagram of a grid: -o diagram.png --along gamma --omega 0.5
    """
    from service import local

    if output == "-":
        rule = 'must be a file: what is computed is kept beside it; "bounce diagram ID --format csv" streams'
        raise click.BadParameter(rule, param_hint="'-o'")
    format = output_format(output, _RUN_FORMATS, format)
    query = {name: value for name, value in query.items() if value is not None}
    if query and format in ("zarr", *EXPORTS):
        option, pictures = next(iter(query)).replace("_", "-"), ", ".join((*PICTURES, *TABLES))
        raise click.UsageError(f"--{option} is of a picture or table: -o with one of {pictures}")
    specification = _specification(spec, effort)
    # The imports of this process count.
    computing: dict[str, Any] = {"workers": workers, "budget": budget, "began": BEGAN}
    try:
        if format == "zarr":
            local.run_to_store(specification, output, **computing)
        else:
            local.run_to_file(specification, output, format, query, **computing)
    except SystemExit:  # by a signal
        click.echo(f"interrupted; the same command goes on in {local.partial_of(Path(output))}", err=True)
        raise


@click.command()
@click.argument("spec", type=click.Path(exists=True, dir_okay=False, allow_dash=True))
@click.option("--budget", type=seconds, metavar="TIME",
              help="Time that the recommended setting takes at most: 90s, 5m, 1h.")  # fmt: skip
@click.option(
    "--tolerance", type=Number(0, 1, min_open=True, max_open=True),
    help="Share of the plane that it shows wrong at most.  [default: 0.05 without a budget]",
)  # fmt: skip
@click.option("-o", "--output", type=click.Path(dir_okay=False), help="Picture or table to write.")
@json_option
@with_client
def plan(client: "Client", spec: str, as_json: bool, output: str | None, **query: Any) -> None:
    """Show what efforts and grids of a sweep would cost.

    It also says how much of the picture each would show wrong: a share of the plane, from pilot points that
    every setting computes. Seconds are those of the service's workers.
    """
    from service.cli.output import as_json as json_text
    from service.cli.views import table

    specification = _specification(spec)
    if output is not None:
        format = output_format(output, (*get_args(DatasetFormat), *PICTURES))
        write_file(output, client.plan_file(specification, format, **query))
        return
    settings = client.plan(specification, **query)
    if as_json:
        rows = settings.to_dataframe().reset_index(drop=True)
        rows["spec"] = [json.loads(text) for text in rows["spec"]]
        click.echo(json_text({"rows": rows.to_dict("records")}))
    else:
        click.echo(table(settings.drop_vars("spec"), ["share"]))


@click.command("import")
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@with_client
def import_file(client: "Client", file: str) -> None:
    """Make the sweep of a shared FILE a job, and print its id.

    FILE is a page of "bounce share" with all numbers of the sweep. Its audit and measured points stay behind.
    """
    click.echo(client.import_shared(file).id)


@click.command()
@json_option
@with_job
def status(job: "Job", as_json: bool) -> None:
    """Show a job's status."""
    from service.cli import output

    click.echo(output.as_json(job.view) if as_json else output.job_report(job))


@click.command()
@click.option("--timeout", type=Number(min=0), help="Stop waiting after this many seconds.")
@with_job
def wait(job: "Job", timeout: float | None) -> None:
    """Show a job's progress until it is finished.

    The exit code is 0 if the job is done, 1 if it failed, was cancelled or the timeout expired.
    """
    _wait(job, timeout)


@click.command()
@click.option("--interval", type=Number(min=0.1), default=1.0, show_default=True,
              help="Seconds between two looks.")  # fmt: skip
@with_client
def watch(client: "Client", interval: float) -> None:
    """Show jobs live until Ctrl-C.

    Lists queued and running jobs, and those that end meanwhile. Where the output is no terminal, prints one
    table and ends.
    """
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    from service.cli import output
    from service.client import errors

    console = Console()
    unfinished: set[str] = set()
    ended: dict[str, Job] = {}

    def jobs() -> "list[Job]":
        queued = {job.id: job for job in client.jobs("queued")}  # before those that begin meanwhile
        running = {job.id: job for job in client.jobs("running")}
        listed = running | queued | running
        for id in unfinished - listed.keys():
            with suppress(errors.NotFound):  # deleted
                ended[id] = client.job(id)
        return [*listed.values(), *(job for id, job in ended.items() if id not in listed)]

    now = jobs()
    shown = output.job_table(now)
    if not console.is_terminal:
        click.echo(shown)
        return
    with Live(console=console, auto_refresh=False) as live:
        while True:
            live.update(Text(shown), refresh=True)
            unfinished = {job.id for job in now if not job.finished}
            time.sleep(interval)
            try:
                now = jobs()
                shown = output.job_table(now)
            except (errors.ServiceUnreachable, errors.Busy) as error:  # it may come back
                shown = str(error)


@click.command()
@with_job
def cancel(job: "Job") -> None:
    """Cancel a job. Its results are kept; submitting the same sweep resumes it."""
    from service.client.display import summary

    job.cancel()
    click.echo(summary(job) if job.finished else f"{summary(job)}, cancel requested", err=True)


@click.command()
@with_job
def resume(job: "Job") -> None:
    """Resume a failed or cancelled job where it stopped.

    A job of another kernel version starts anew as another job, whose id is printed.
    """
    from service.client.display import summary

    asked_for = job.id
    job.resume()
    if job.id != asked_for:
        click.echo(job.id)
        click.echo(f"job {job.id} {job.notice}", err=True)
    click.echo(summary(job), err=True)


@click.command()
@with_job
@click.argument("name")
def rename(job: "Job", name: str) -> None:
    """Give a job another NAME. Its id and its numbers stay."""
    job.rename(name)


@click.command()
@with_job
def delete(job: "Job") -> None:
    """Delete a job and its results. Cancel it first if it is queued or running."""
    job.delete()


@click.command("list")
@click.option("--state", type=click.Choice(STATES), help="List only the jobs in this state.")
@click.option("--search", help="List only jobs with this text in their name, or whose id begins so.")
@click.option("--model", help="List only jobs of this kind of contact.")
@click.option("--pinned", is_flag=True, help="List only pinned jobs.")
@click.option(
    "--from", "created_from", type=day, metavar="DATE", help="List only jobs created on DATE (UTC) or later."
)
@click.option(
    "--before", "created_before", type=day, metavar="DATE", help="List only jobs created before DATE (UTC)."
)
@click.option("--order", type=click.Choice(ORDERS), default=ORDERS[0], show_default=True)
@click.option("--limit", type=click.IntRange(1), help="List at most this many jobs.")
@json_option
@with_client
def list_jobs(client: "Client", as_json: bool, pinned: bool, limit: int | None, **wanted: Any) -> None:
    """List the jobs, the newest first."""
    from service.cli import output

    jobs = list(islice(client.jobs(pinned=pinned or None, **wanted), limit and min(limit, sys.maxsize)))
    click.echo(output.as_json([job.view for job in jobs]) if as_json else output.job_table(jobs))


COMMANDS: Final = (
    submit, plan, run, import_file, status, wait, watch, cancel, resume, rename, delete, list_jobs,
)  # fmt: skip


def _specification(spec: str, effort: str | None = None) -> Mapping[str, Any]:
    """The specification in a file, or for - in standard input, with this effort if given."""
    from service.client.specification import read

    fields = read(Path(spec) if spec != "-" else sys.stdin.buffer.read())
    return fields if effort is None else {**fields, "effort": effort}


def _wait(job: "Job", timeout: float | None = None) -> None:
    from service.client.display import settling_note

    submitted = job.id
    try:
        job.wait(timeout=timeout)
        if job.id != submitted:
            click.echo(
                f"job {submitted} was replaced by job {job.id}, of this service's kernel version", err=True
            )
        if note := settling_note(job):
            click.echo(note, err=True)
    except SystemExit:  # by a signal
        click.echo(f"stopped waiting; the job continues (cancel it with: bounce cancel {job.id})", err=True)
        raise
