"""Chunks computed in threads of this process."""

import threading

import pytest
from scripted import DEADLINE, wait_for

from kernel.stopping import check
from worker.executors.base import ClusterState
from worker.executors.inline import Inline


def test_a_call_stops_when_it_is_cancelled(inline: Inline):
    begun = threading.Event()

    def endless() -> None:
        while True:
            begun.set()
            check()

    call = inline.call(endless)
    assert begun.wait(DEADLINE)
    call.cancel()
    assert inline.call(len, "abc").result(DEADLINE) == 3


def test_what_has_not_begun_is_cancelled_at_the_end_and_nothing_begins_any_more():
    executor, begun, over = Inline(), threading.Event(), threading.Event()

    def task() -> bool:
        begun.set()
        return over.wait(DEADLINE)

    running, waiting = executor.call(task), executor.call(len, "abc")
    assert begun.wait(DEADLINE)
    assert executor.workers() == 1
    assert executor.state() == ClusterState(connected=True, workers=1)
    closing = threading.Thread(target=executor.close)
    closing.start()
    try:
        wait_for(waiting.cancelled)
    finally:
        over.set()
        closing.join()
    assert running.result(0) is True
    assert executor.workers() == 0
    assert executor.state() == ClusterState(connected=False, workers=0)
    with pytest.raises(RuntimeError):
        executor.call(len, "abc")
