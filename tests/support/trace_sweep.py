"""Follows one sweep through a running service: `python trace_sweep.py` prints the project's files it enters.

From `Client.submit` to the diagram, in this process: a real web server, an Inline executor, kernels
interpreted so that they can be followed too. A file is printed when one of its functions is first entered.
"""

import gc
import os
import sys
import tempfile
import threading
from contextlib import closing
from pathlib import Path
from types import FrameType
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"

from service.client import Client
from service.server import embedded
from service.settings import read_settings
from worker.executors.inline import Inline

ROOT = Path(__file__).parents[2]
PACKAGES = ("kernel", "worker", "service")
SWEEP = {
    "gamma": {"start": 1.2, "stop": 2.0, "num": 3}, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "settle": 9, "observe": 2, "keep": 4,  # flights enough to look whether they repeat
}  # fmt: skip

entered: dict[str, None] = {}
following = threading.Event()


def follow(frame: FrameType, event: str, _: Any) -> None:
    code = frame.f_code
    if event != "call" or not following.is_set() or code.co_name.startswith("<"):
        return
    path = Path(code.co_filename)
    if path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in PACKAGES:
        entered.setdefault(str(path.relative_to(ROOT)))


def main() -> None:
    gc.disable()  # Python 3.11.2 may crash where it collects while a generator is followed
    threading.setprofile(follow)
    with (
        tempfile.TemporaryDirectory() as data,
        closing(Inline()) as executor,
        embedded.running(read_settings(data=data, port=0), executor) as url,
        Client(url, timeout=600.0) as client,
    ):
        following.set()
        sys.setprofile(follow)
        job = client.submit(SWEEP)
        job.wait(progress=False)
        job.diagram(along="gamma", omega=0.5, xi=0.26)
        sys.setprofile(None)
        following.clear()
    sys.stdout.write("\n".join(entered))


if __name__ == "__main__":
    main()
