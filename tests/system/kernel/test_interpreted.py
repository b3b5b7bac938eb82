"""The same numbers without compilation, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from kernel_runs import EACH_MODEL, run
from paths import ROOT, SUPPORT


def numbers() -> np.ndarray:
    """A small line of every model, from rest and as a ramp."""
    rows = []
    for model, contact in (case.values for case in EACH_MODEL):
        for carry in (False, True):
            line = run([2.5, 2.6], 0.7, 0.05, model, settle=1, observe=2, keep=4, carry=carry, **contact)
            rows.append(np.nan_to_num([*line.flight_time.ravel(), *line.end_state.ravel()]))
    return np.array(rows)


def test_without_compilation_the_numbers_are_the_same():
    """NUMBA_DISABLE_JIT=1 runs the same sources in Python, as coverage does."""
    script = "import test_interpreted as t; print(*(x.hex() for x in t.numbers().ravel()))"
    path = os.pathsep.join(map(str, (Path(__file__).parent, SUPPORT, ROOT)))
    variables = os.environ | {"PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    interpreted = [float.fromhex(x) for x in done.stdout.split()]
    assert interpreted == pytest.approx(numbers().ravel(), abs=1e-12)
