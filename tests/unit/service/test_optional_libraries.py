"""What an installation without extras can do."""

import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from extras import EXTRAS
from paths import CACHE, ROOT
from scripted import DEADLINE

SWEEP: Final[dict[str, Any]] = {
    "gamma": [1.2, 1.3], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "settle": 5, "observe": 5,
}  # fmt: skip

#: Imports nothing of the extras, as if they were not installed.
WITHOUT: Final = """
import importlib.abc, importlib.util, sys

class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {missing}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing())
"""


def test_a_program_without_any_extra_computes_and_writes_all_else(tmp_path: Path):
    """In a process that can import nothing but what the project depends on."""
    code = WITHOUT.format(missing=EXTRAS) + (
        "from service import local; import pathlib;"
        f"spec, folder = {SWEEP!r}, pathlib.Path({str(tmp_path)!r});"
        "[local.run_to_file(spec, folder / f'a.{ending}', ending, {'omega': 0.5, 'xi': 0.26}, progress=False)"
        " for ending in ('nc', 'parquet', 'csv', 'png')];"
        "print(len(local.run(spec, progress=False).gamma))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, timeout=DEADLINE,
        env={"NUMBA_CACHE_DIR": str(CACHE), "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr
    assert {path.suffix for path in tmp_path.glob("a.*")} == {".nc", ".parquet", ".csv", ".png"}
