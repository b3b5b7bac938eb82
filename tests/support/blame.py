"""The errors of chunks: those that use up a try, and the others."""

import pytest

from service.jobs.run import JobRun
from worker.executors.base import WorkerDied, WorkerLost


def noting_errors(monkeypatch: pytest.MonkeyPatch) -> list[BaseException]:
    """The errors of all chunks from now on, as they come."""
    seen: list[BaseException] = []
    apply = JobRun.apply

    def noted(run: JobRun, chunk: int, action: object, error: BaseException, again: bool = False) -> None:
        seen.append(error)
        apply(run, chunk, action, error, again)

    monkeypatch.setattr(JobRun, "apply", noted)
    return seen


def blamed(errors: list[BaseException]) -> list[BaseException]:
    """The errors that use up a try."""
    return [error for error in errors if isinstance(error, WorkerDied | WorkerLost)]
