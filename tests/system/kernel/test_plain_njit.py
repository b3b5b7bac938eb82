"""The kernel compiled by plain `numba.njit`."""

import os
import subprocess
import sys

from paths import ROOT

RUN = """
import numpy as np
from kernel.line import run_line
from kernel.models import rigid
axis = np.linspace(1.0, 3.0, 5)
line = run_line(axis, axis, 0.1 * axis, plate=rigid.plate(restitution=np.full(5, 0.3)), carry=False,
                settle=50, observe=50, keep=8)
print(line.flight_time.tobytes().hex())
"""


def test_plain_njit_gives_the_same_bytes():
    """The switch back, should numba change what `kernel.numerics.compilation` rests on."""
    runs = [
        subprocess.run(
            [sys.executable, "-c", RUN], cwd=ROOT, capture_output=True, text=True, check=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)} | more,
        )
        for more in ({}, {"BOUNCE_PLAIN_NJIT": "1"})
    ]  # fmt: skip
    assert runs[0].stdout == runs[1].stdout
