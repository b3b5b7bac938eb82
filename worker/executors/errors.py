"""Errors of the executor, not of the task.

ExecutorError
├── WorkerDied      its worker process died while running it, or was terminated because of it
├── WorkerLost      its worker process died before the task began
├── WorkerLeft      its worker was told to leave, by a batch queue, its lifetime or an operator
├── WorkerRefused   its worker may not compute: it differs from the service, or does not see the stores
├── ReportMismatch  its worker reported another chunk than the one it was given
└── ClusterLost     the scheduler is gone, or was never reached
"""


class ExecutorError(Exception):
    """An error of the executor: the task has no result but raised nothing itself."""


class WorkerDied(ExecutorError):
    """The worker process died while it ran this task; the message gives the reason, if known."""


class WorkerLost(ExecutorError):
    """The worker process died while this task waited there: another task is to blame."""


class WorkerLeft(ExecutorError):
    """The worker was told to leave before the task was done."""


class WorkerRefused(ExecutorError):
    """The worker was not admitted; the message gives the reason."""


class ReportMismatch(ExecutorError):
    """The worker reported another chunk than the one it was given, or other cells."""


class ClusterLost(ExecutorError):
    """The scheduler cannot be reached; all its tasks are lost."""
