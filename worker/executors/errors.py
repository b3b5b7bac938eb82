"""Room: why a chunk came back without a report, though its task did not fail.

ExecutorError
├── WorkerDied      the process that computed it died, or was ended because of it
├── WorkerLost      the process died at which it waited: not its fault
└── ClusterLost     the scheduler is gone, or was never there
"""


class ExecutorError(Exception):
    """Why a chunk came back without a report, though its task did not fail."""


class WorkerDied(ExecutorError):
    """The worker process died while it computed this chunk; says why, if that is known."""


class WorkerLost(ExecutorError):
    """The worker process died while this chunk waited there."""


class ClusterLost(ExecutorError):
    """The scheduler cannot be reached; whatever it had is lost."""
