"""The same numbers without compilation, in a process of its own."""

import json
import os
import subprocess
import sys

import numpy as np
import paths

INTERPRETED = """
import json
import numpy as np
from kernel_runs import Model, run_line
for model, e in ((Model.BALL, 0.3), (Model.STEPPED, 0.5)):
    g = np.array([1.7, 2.9])
    line = run_line(g, 0.5 + 0 * g, 0.3 + 0 * g, model=model, restitution=e + 0 * g, penetration=0.05 + 0 * g,
                    adhesive=False, carry=True, settle=2, observe=3, keep=16)
    print(json.dumps([line.flight_time.tolist(), line.end_state.tolist()]))
"""


def test_interpreted_kernels_say_the_same():
    printed = []
    for disabled in ("0", "1"):
        environment = os.environ | {
            "NUMBA_DISABLE_JIT": disabled,
            "PYTHONPATH": os.pathsep.join(map(str, (paths.SUPPORT, paths.ROOT))),
        }
        done = subprocess.run(
            [sys.executable, "-c", INTERPRETED], env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        printed.append([json.loads(line) for line in done.stdout.splitlines()])
    for compiled, interpreted in zip(*printed, strict=True):
        for one, other in zip(compiled, interpreted, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
