"""Decides about chunks that came back without a report. The only module that classifies errors."""

import errno
from collections.abc import Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from worker import store
from worker.executors.base import ClusterLost, WorkerLeft, WorkerLost, WorkerRefused
from worker.store import StoreDamaged
from worker.study import ChunkCancelled, ChunkPaused, PredecessorMissing

#: A worker's death often hits innocent chunks. After this many such losses a chunk is suspect itself, and
#: each further loss counts as a failed try.
MAX_COLLATERAL_LOSSES: Final = 10

#: Operating-system errors that would hit every chunk of the job: disk full, quota used up, file size limit, a
#: link in its store; and at the last try also a read-only file system.
FATAL_ERRNOS: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ELOOP})
FATAL_AT_LAST: Final = FATAL_ERRNOS | {errno.EROFS}


class Action(Enum):
    """The action of the supervisor on the chunk."""

    REQUEUE = "requeue"  # nothing is counted
    CONTINUE = "continue"  # requeue before the job's other chunks; nothing is counted
    PAUSE = "pause"  # requeue, and submit nothing until a sync finds workers
    COLLATERAL = "collateral"  # requeue, and count a collateral loss
    RETRY = "retry"  # requeue, and count a failed try
    GIVE_UP = "give up"  # record the failure; chunks that depend on this one are not tried
    FATAL = "fatal"  # record the failure, and submit no further chunk of the job


#: The actions that record a failed try.
FAILED_TRIES: Final = frozenset({Action.RETRY, Action.GIVE_UP, Action.FATAL})

#: Errors that are no fault of the chunk, and the action.
UNCOUNTED: Final[Mapping[type[BaseException], Action]] = {
    ChunkCancelled: Action.REQUEUE,
    CancelledError: Action.REQUEUE,
    ChunkPaused: Action.CONTINUE,
    ClusterLost: Action.PAUSE,
    WorkerLeft: Action.CONTINUE,
    WorkerRefused: Action.CONTINUE,
    store.Unreachable: Action.PAUSE,
}


class Decision(NamedTuple):
    """The policy's decision on a chunk that came back without a report."""

    action: Action
    recompute_predecessor: bool = False  # its stored end states are missing or damaged


class History(NamedTuple):
    """The history of a chunk and its job before the error."""

    tries: int = 0  # failed tries of this chunk
    collateral_losses: int = 0  # of this chunk
    has_predecessor: bool = False  # the chunk continues a ramp
    stopping: bool = False  # the job is being cancelled
    fatal: bool = False  # another chunk of the job met a fatal error


@dataclass(frozen=True)
class RetryPolicy:
    """Decides after an error whether a chunk is tried again, and when a job stops trying."""

    chunk_tries: int  # limit on tries of a chunk that fails, or whose worker dies
    failed_chunks: int  # failed chunks after which a job submits no more

    def decide(self, error: BaseException, history: History) -> Decision:
        """Decide about a chunk with this history after `error`."""
        for kind, action in UNCOUNTED.items():
            if isinstance(error, kind):
                return Decision(action)
        if isinstance(error, WorkerLost):
            if history.collateral_losses + 1 < MAX_COLLATERAL_LOSSES:
                return Decision(Action.COLLATERAL)
            return Decision(self._after_failed_try(error, history))
        if history.stopping:
            return Decision(Action.REQUEUE)  # not tried again unless the job is resumed
        damaged = history.has_predecessor and isinstance(error, StoreDamaged | PredecessorMissing)
        return Decision(self._after_failed_try(error, history), recompute_predecessor=damaged)

    def _after_failed_try(self, error: BaseException, history: History) -> Action:
        last = history.tries + 1 >= self.chunk_tries
        fatal = FATAL_AT_LAST if last else FATAL_ERRNOS
        if history.fatal or (isinstance(error, OSError) and error.errno in fatal):
            return Action.FATAL
        return Action.GIVE_UP if last else Action.RETRY
