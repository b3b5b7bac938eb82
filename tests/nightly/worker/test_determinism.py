"""Compiled code from the cache computes what code just compiled does."""

import os
import subprocess
import sys

from paths import ROOT

KERNEL = """
from worker.kernel_cache import use_cache
print(use_cache())
import hashlib
import numpy as np
from kernel.line import run_line
from kernel.models import rigid
gamma, one = np.linspace(0.5, 5.0, 100), np.ones(100)
plate = rigid.plate(restitution=0 * one)
line = run_line(gamma, one, 0.26 * one, plate=plate, carry=False, settle=20, observe=20, keep=8)
print(hashlib.sha256(line.flight_time.tobytes() + line.end_state.tobytes()).hexdigest())
"""


def test_code_from_the_cache_computes_what_code_just_compiled_does(tmp_path):
    """One worker compiles, another loads compiled code: both may compute parts of one job."""
    digests = [
        subprocess.run(
            [sys.executable, "-c", KERNEL],
            stdout=subprocess.PIPE,
            cwd=ROOT,
            check=True,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        ).stdout
        for _ in range(2)
    ]
    assert digests[0] == digests[1]
