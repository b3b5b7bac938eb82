"""Why a task has no result although it raised nothing itself.

ExecutorError
├── WorkerDied      its worker process died while running it, or was terminated because of it
├── WorkerLost      its worker process died before the task began
├── WorkerLeft      its worker was told to leave, by a batch queue, its lifetime or an operator
├── WorkerRefused   its worker may not compute: it differs from the service, or does not see the stores
├── ReportMismatch  its worker reported another chunk than the one it was given
└── ClusterLost     the scheduler is gone, or was never reached
"""


class ExecutorError(Exception):
    """A task has no result although it raised nothing itself."""


class WorkerDied(ExecutorError):
    """The worker process died while it ran this task; the message says why, if that is known."""


class WorkerLost(ExecutorError):
    """The worker process at which this task waited died: another task is to blame."""


class WorkerLeft(ExecutorError):
    """The worker was told to leave before the task was done: nobody is to blame."""


class WorkerRefused(ExecutorError):
    """The worker may not compute; the message says why."""


class ReportMismatch(ExecutorError):
    """The worker reported another chunk than the one it was given, or other cells."""


class ClusterLost(ExecutorError):
    """The scheduler cannot be reached; all tasks it had are lost."""
