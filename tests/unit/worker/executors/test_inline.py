"""Chunks computed in threads of this process."""

import threading

from scripted import DEADLINE

from kernel.stopping import check
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
