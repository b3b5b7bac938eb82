"""The same bytes whatever vector instructions the processor has: AVX-512, AVX2, those of every x86-64."""

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from kernel_runs import digest

from kernel.line import run_line
from kernel.models import ball, rigid, soft
from kernel.params import LANES

ROOT = Path(__file__).parents[3]  # not from `paths`: this file is run by itself, too

#: Of the plate under n cells: e, and of soft ones d and whether adhesive.
CONTACTS = {
    "rigid": lambda n: rigid.plate(restitution=np.zeros(n)),
    "rigid, e = 0.3": lambda n: rigid.plate(restitution=np.full(n, 0.3)),
    "adhesive": lambda n: soft.plate(
        restitution=np.full(n, 0.01), penetration=np.full(n, 1e-3), adhesive=True
    ),
    "nonadhesive": lambda n: soft.plate(
        restitution=np.full(n, 0.3), penetration=np.full(n, 1e-5), adhesive=False
    ),
    "ball": lambda n: ball.plate(restitution=np.full(n, 0.3)),
}


def digests() -> dict[str, str]:
    """Of random cells from rest, and as lines of a ramp of one, of half, of all lanes; certified or not."""
    random, length, found = np.random.default_rng(5), 5, {}
    for lines in (1, LANES // 2, 2 * LANES + 1):
        gamma = np.tile(np.linspace(0.5, 5, length), lines)
        omega, xi = random.uniform(0.2, 2, lines), 10 ** random.uniform(-2, 0.3, lines)
        cells = gamma, np.repeat(omega, length), np.repeat(xi, length)
        for name, plate in CONTACTS.items():
            for carry, certify in itertools.product((False, True), repeat=2):
                done = run_line(
                    *cells, plate=plate(len(gamma)), carry=carry, start=[None] * lines if carry else None,
                    settle=20, observe=20, keep=16, certify=certify,
                )  # fmt: skip
                found[f"{name}, {lines} lines, carry {carry}, certify {certify}"] = digest(done)
    return found


@pytest.mark.parametrize("processor", ["haswell", "generic"])
def test_the_bytes_do_not_depend_on_the_instructions(processor):
    paths = [str(ROOT), str(ROOT / "tests" / "support")]
    environment = os.environ | {"NUMBA_CPU_NAME": processor, "PYTHONPATH": os.pathsep.join(paths)}
    environment |= {"NUMBA_CPU_FEATURES": "" if processor == "generic" else "+avx2,+fma"}
    environment.pop("NUMBA_CACHE_DIR", None)
    answer = subprocess.run(
        [sys.executable, __file__], env=environment, cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert json.loads(answer.stdout) == digests()


if __name__ == "__main__":
    sys.stdout.write(json.dumps(digests()))
