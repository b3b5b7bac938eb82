"""What follows a chunk that failed, as a table."""

import errno
from concurrent.futures import CancelledError

import pytest
from tables import for_each

from service.jobs.retry import MAX_COLLATERAL_LOSSES, Action, Decision, History, RetryPolicy
from worker.executors.base import ClusterLost, WorkerDied, WorkerLeft, WorkerLost, WorkerRefused
from worker.store import StoreDamaged, StoreMissing, Unreachable
from worker.study import ChunkCancelled, PredecessorMissing

POLICY = RetryPolicy(chunk_tries=3, failed_chunks=8)

FRESH = History()
SECOND_TRY = History(tries=1)
LAST_TRY = History(tries=2)
STOPPING = History(tries=2, stopping=True)
FATAL = History(fatal=True)
ON_A_RAMP = History(has_predecessor=True)
LOSSES_LEFT = History(collateral_losses=MAX_COLLATERAL_LOSSES - 2)
LAST_LOSS = History(collateral_losses=MAX_COLLATERAL_LOSSES - 1)
SUSPECT = History(tries=2, collateral_losses=MAX_COLLATERAL_LOSSES - 1)

DISK_FULL = OSError(errno.ENOSPC, "No space left on device")
READ_ONLY = OSError(errno.EROFS, "Read-only file system")
INTERRUPTED = OSError(errno.EIO, "Input/output error")


@for_each(("error", "history", "action"), [
    # cancelled: nothing is counted, whatever happened before
    (ChunkCancelled("cancelled"), LAST_TRY, Action.REQUEUE),
    (CancelledError(), FATAL, Action.REQUEUE),
    # the cluster is gone
    (ClusterLost("gone"), LAST_TRY, Action.PAUSE),
    (ClusterLost("gone"), STOPPING, Action.PAUSE),
    # the bucket does not answer
    *((Unreachable("gone"), history, Action.PAUSE) for history in (FRESH, LAST_TRY, FATAL)),
    # the worker was told to leave, or may not compute
    *((kind("no"), history, Action.CONTINUE) for kind in (WorkerLeft, WorkerRefused)
      for history in (FRESH, LAST_TRY, LAST_LOSS, FATAL, STOPPING)),
    # the worker died on another chunk
    (WorkerLost("gone"), LAST_TRY, Action.COLLATERAL),
    (WorkerLost("gone"), STOPPING, Action.COLLATERAL),
    (WorkerLost("gone"), LOSSES_LEFT, Action.COLLATERAL),
    (WorkerLost("gone"), LAST_LOSS, Action.RETRY),
    (WorkerLost("gone"), SUSPECT, Action.GIVE_UP),
    # the chunk failed, or its worker died of it
    (ValueError("no"), FRESH, Action.RETRY),
    (ValueError("no"), SECOND_TRY, Action.RETRY),
    (ValueError("no"), LAST_TRY, Action.GIVE_UP),
    (ValueError("no"), STOPPING, Action.REQUEUE),
    (WorkerDied("gone"), FRESH, Action.RETRY),
    (StoreMissing("no store"), FRESH, Action.RETRY),
    (WorkerDied("gone"), LAST_TRY, Action.GIVE_UP),
    # no chunk of the job can be stored
    (DISK_FULL, FRESH, Action.FATAL),
    (OSError(errno.EDQUOT, "quota"), FRESH, Action.FATAL),
    (OSError(errno.EFBIG, "too big"), FRESH, Action.FATAL),
    (OSError(errno.ELOOP, "a symbolic link"), FRESH, Action.FATAL),
    (DISK_FULL, LAST_TRY, Action.FATAL),
    (READ_ONLY, LAST_TRY, Action.FATAL),
    (DISK_FULL, STOPPING, Action.REQUEUE),
    (INTERRUPTED, FRESH, Action.RETRY),
    (INTERRUPTED, LAST_TRY, Action.GIVE_UP),
    (READ_ONLY, FRESH, Action.RETRY),  # perhaps of one machine alone
    (ValueError("no"), FATAL, Action.FATAL),
])  # fmt: skip
def test_what_follows_an_error(error: BaseException, history: History, action: Action):
    assert POLICY.decide(error, history) == Decision(action)


@pytest.mark.parametrize("error", [StoreDamaged("damaged"), PredecessorMissing("missing")])
def test_a_predecessor_whose_end_state_cannot_be_read_is_computed_again(error: Exception):
    assert POLICY.decide(error, ON_A_RAMP) == Decision(Action.RETRY, recompute_predecessor=True)
    last = ON_A_RAMP._replace(tries=2)
    assert POLICY.decide(error, last) == Decision(Action.GIVE_UP, recompute_predecessor=True)
    assert not POLICY.decide(error, FRESH).recompute_predecessor
    assert not POLICY.decide(error, ON_A_RAMP._replace(stopping=True)).recompute_predecessor
