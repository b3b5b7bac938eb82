"""The kernel with a numba whose internals are renamed: compiled by plain `numba.njit`."""

import os
import subprocess
import sys
from pathlib import Path

from changed_numba import changed_numba
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
FIGURE = ["-m", "service.cli.entry", "figure", "2", "-o", "figure-2.png"]


def both(words: list[str], folder: Path, timeout: float) -> list[subprocess.CompletedProcess[str]]:
    """What Python prints in `folder`/own, and with the changed numba in `folder`/changed."""
    environments = {"own": dict(os.environ), "changed": changed_numba(folder)}
    for name in environments:
        (folder / name).mkdir()
    return [
        subprocess.run(
            [sys.executable, *words], cwd=folder / name, env=environment, capture_output=True, text=True,
            check=True, timeout=timeout,
        )
        for name, environment in environments.items()
    ]  # fmt: skip


def test_its_bytes_are_the_same(tmp_path: Path):
    own, changed = both(["-c", RUN], tmp_path, 600)
    assert own.stdout == changed.stdout


def test_the_first_command_of_the_readme_draws_the_same_picture_with_one_warning(tmp_path: Path):
    assert "bounce figure 2 -o figure-2.png" in (ROOT / "README.md").read_text()
    _, changed = both(FIGURE, tmp_path, 800)
    assert changed.stderr.count("compiles its kernels anew") == 1
    own, drawn = ((tmp_path / name / "figure-2.png").read_bytes() for name in ("own", "changed"))
    assert own == drawn
