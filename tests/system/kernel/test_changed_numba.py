"""A numba whose internals are renamed still compiles the kernel."""

import os
import subprocess
import sys
from pathlib import Path

from changed_numba import changed_numba
from paths import ROOT

PROGRAM = """
import subprocess, sys
from typing import NamedTuple
from kernel.numerics.elementary import fma, multiply_add
from kernel.numerics.jit import PLAIN, by_type, inlined, jit

class Law(NamedTuple):
    factor: float

@by_type
def force(law, x):
    "A force."

@force.register(Law)
@inlined
def _force(law, x):
    return multiply_add(law.factor, x, 1.0, True)

@jit
def total(law, x):
    return force(law, x) + fma(x, x, -1.0)

print(PLAIN, total(Law(3.0), 1.0 + 2.0**-30).hex())
if len(sys.argv) == 1:
    subprocess.run([sys.executable, __file__, "a process that it starts"], check=True)
"""


def test_plain_njit_compiles_the_same_with_one_warning(tmp_path: Path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    own, changed = (
        subprocess.run(
            [sys.executable, program], cwd=ROOT, env=env, capture_output=True, text=True, check=True
        )
        for env in (dict(os.environ), changed_numba(tmp_path))
    )
    assert changed.stdout == own.stdout.replace("False", "True")
    assert own.stderr == ""
    assert changed.stderr.count("every process now compiles its kernels anew") == 1
    assert "cannot import name" in changed.stderr
