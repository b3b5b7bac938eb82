"""Jobs accepted by a ledger, and reports of their chunks."""

from service.jobs.ledger import Ledger
from service.jobs.model import JobRecord, NewJob
from worker.tasks import ChunkReport


def new_job(job_id: str = "a" * 32, chunks: int = 4) -> NewJob:
    return NewJob(job_id, "a name", '{"gamma": 1.0}', "1", (1, 2, 3), chunks, 10 * chunks)


def accept(ledger: Ledger, job_id: str = "a" * 32, chunks: int = 4) -> JobRecord:
    with ledger.writing() as writing:
        writing.insert(new_job(job_id, chunks), now=100.0)
    return current(ledger, job_id)


def current(ledger: Ledger, job_id: str = "a" * 32) -> JobRecord:
    job = ledger.find(job_id)
    assert job is not None
    return job


def reports(*chunks: int) -> list[ChunkReport]:
    return [ChunkReport(chunk, 10, 0.5, 0.4, f"{chunk:064x}", (0, 10, 0, 0, 0, 0, 0)) for chunk in chunks]
