"""The commands on the data folder itself, which need no service: backup, restore, adopt, doctor."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from service.cli.options import data_option, names_url, plural, url_option
from service.tokens import find_service

if TYPE_CHECKING:
    from service.settings import Settings


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@data_option
def backup(file: Path, data: str | None) -> None:
    """Copy the ledger to FILE, also while the service runs.

    FILE has all jobs and marks of one moment, or is left as it was. Results are not in it: copy the stores
    too, after the ledger.
    """
    from service.ledger import backup as backups

    contents = backups.backup(_settings(data).ledger_path, file)
    click.echo(f"{file}: {plural(contents.jobs, 'job')}, {plural(contents.chunks, 'done chunk')}")


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@data_option
def restore(file: Path, data: str | None) -> None:
    """Put a backup in place of the ledger.

    No service may be using the folder.

    The ledger that was there is kept beside it. Stores that the backup does not know are left alone: "bounce
    adopt --all" takes them in.
    """
    from service.jobs.stores import opening
    from service.ledger import backup as backups

    settings = _settings(data)
    check_marker = partial(opening.own_marker, settings, then=", restore again")
    (jobs, chunks), replaced = backups.restore(settings.ledger_path, file, check_marker)
    click.echo(f"{settings.ledger_path}: {plural(jobs, 'job')}, {plural(chunks, 'done chunk')}")
    if replaced is not None:
        click.echo(f"the ledger that was there is {replaced}")
    with opening.open_ledger(settings) as ledger:
        unknown = opening.find_unknown(ledger, settings)
    if unknown:
        taken = "bounce adopt --all takes in those of jobs that it lacks"
        click.echo(f"{plural(len(unknown), 'store')} unknown to it: {taken}")


@click.command()
@click.argument("stores", metavar="[STORE]...", nargs=-1)
@click.option("--all", "every", is_flag=True, help="Adopt every store that the ledger does not know.")
@data_option
def adopt(stores: tuple[str, ...], every: bool, data: str | None) -> None:
    """Take in stores that the ledger does not know.

    No service may be using the folder.

    STORE is a job's id or the name of its store. Every chunk is read; those that are whole count as done, and
    "bounce resume" computes the others. Stores are not changed.
    """
    from service.errors import NotAdoptable
    from service.jobs.stores import opening
    from service.jobs.stores.adoption import adopt as adopt_store

    if bool(stores) == every:
        raise click.UsageError("name the stores to adopt, or give --all")
    settings, refused = _settings(data), 0
    if not settings.ledger_path.exists() and not opening.has_stores(settings):
        rule = f"{settings.data} has neither a ledger nor stores: it is not the data folder of a service"
        raise click.BadParameter(rule, param_hint="'--data'")
    with opening.open_ledger(settings, adopting=True) as ledger:
        for store in opening.find_unknown(ledger, settings) if every else stores:
            try:
                job = adopt_store(ledger, settings, store)
            except NotAdoptable as error:
                refused += 1
                click.echo(f"Error: {error}", err=True)
            else:
                click.echo(
                    f"{job.id}  {job.state}  {job.chunks_done} of {job.chunks_total} chunks  {job.name}"
                )
    if refused:
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("job", required=False)
@click.option("--verify", is_flag=True, help="Read all results of JOB, or of every job.")
@data_option
@url_option
def doctor(job: str | None, verify: bool, data: str | None, url: str) -> None:
    """Check what the service needs.

    Exits with 1 if something needs attention. Changes nothing without --verify, which names damaged results
    and has them computed again at the next start; while a service uses the folder, it only names them.
    """
    from service.cli import doctor as checks

    if job is not None and not verify:
        raise click.UsageError("JOB needs --verify")
    settings = _settings(data)
    address = find_service(settings.data) if data is not None and not names_url() else url
    all_ok = True
    for finding in checks.verify(settings, job) if verify else checks.examine(settings, address):
        click.echo(f"{'ok' if finding.ok else '!!':<4}{finding.subject:<18}{finding.text}")
        all_ok = all_ok and finding.ok
    if not all_ok:
        raise click.exceptions.Exit(1)


COMMANDS = (backup, restore, adopt, doctor)


def _settings(data: str | None) -> "Settings":
    from service.settings import read_settings

    return read_settings(data=data)
