"""Threads for work that jobs and short requests must not wait for."""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Final

#: Added to the niceness of these threads: beside two busy worker processes one gets a third of a processor.
NICER: Final = 3


def background_threads(count: int, name: str) -> ThreadPoolExecutor:
    """So many threads of lower priority than the rest of this process, where the system has such (Linux)."""
    return ThreadPoolExecutor(count, thread_name_prefix=name, initializer=_lower_priority)


def _lower_priority() -> None:
    if sys.platform == "linux":  # elsewhere a niceness is that of the whole process
        thread = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + NICER)
