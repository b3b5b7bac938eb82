"""Questions of tests about a store's chunks and about the folder of stores."""

from contextlib import suppress
from pathlib import Path

from service.jobs.prepare import JobPreparer
from service.jobs.stores.opening import open_ledger
from service.ledger.ledger import Ledger
from service.settings import Settings
from worker import store
from worker.study import Chunk, Layout


def is_sound(url: str, layout: Layout, chunk: Chunk) -> bool:
    """Whether a chunk is stored whole."""
    try:
        store.read_chunk(url, chunk, layout.names, complete=True)
    except store.StoreDamaged:
        return False
    return True


def marked_and_sound(settings: Settings, job_id: str) -> int:
    """How many chunks of a job the ledger marks as done, each of which is stored whole."""
    with Ledger(settings.ledger_path) as ledger, ledger.reading() as reading:
        job = reading.find(job_id)
        if job is None:
            return 0
        prepared = JobPreparer(settings).prepare(job)
        done = list(reading.done_chunks(job, 0, job.chunks_total))
    assert all(is_sound(prepared.store_url, prepared.layout, prepared.plan[index]) for index in done)
    return len(done)


def store_in(data: Path, job_id: str) -> Path:
    """The store of a data folder's job."""
    [found] = (data / "stores").glob(f"*{job_id}.zarr")
    return found


def files(folder: str | Path) -> dict[str, bytes]:
    """All files below a folder by their paths in it. One that is being renamed is left out."""
    contents = {}
    for path in Path(folder).rglob("*"):
        with suppress(FileNotFoundError):
            if path.is_file():
                contents[str(path.relative_to(folder))] = path.read_bytes()
    return contents


def marked(data: Path) -> tuple[str, str]:
    """Create a data folder; the address of its stores, and their mark."""
    settings = Settings(data=data)
    with open_ledger(settings) as ledger, ledger.reading() as reading:
        return settings.stores_url, reading.marker()[0]
