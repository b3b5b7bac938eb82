"""Tasks as they are sent to a cluster."""

import pickle
import subprocess
import sys

from worker.executors.dask import _Call
from worker.sweep.task import run_chunk


def test_scheduler_and_worker_need_nothing_of_this_project_until_a_task_runs():
    sent = pickle.dumps((pickle.loads, pickle.dumps(_Call(run_chunk, 3))))
    code = (
        "import pickle, sys; function, call = pickle.loads(sys.stdin.buffer.read()); "
        "print('worker' in sys.modules); sys.modules['worker'] = None; function(call)"
    )
    done = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=False)
    assert done.stdout == b"False\n"
    assert b"ModuleNotFoundError" in done.stderr
