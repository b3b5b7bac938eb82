"""Errors of the executor: a task has no result, although it raised nothing itself."""


class ExecutorError(Exception):
    """An error of the executor, not of the task."""


class WorkerDied(ExecutorError):
    """The worker process died while it ran this task; the message gives the reason, if known."""


class WorkerLost(ExecutorError):
    """The worker process died while this task waited there: another task is to blame."""


class WorkerLeft(ExecutorError):
    """The worker was told to leave before the task was done."""


class WorkerRefused(ExecutorError):
    """The worker may not compute: it differs from the service, or does not see the stores."""


class ReportMismatch(ExecutorError):
    """The worker reported another chunk than the one it was given, or other cells."""


class ClusterLost(ExecutorError):
    """The scheduler cannot be reached; all its tasks are lost."""
