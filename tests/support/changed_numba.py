"""A numba whose internals are renamed, for the processes that a test starts."""

import os
from pathlib import Path

#: Python imports this module at the start of every process. numba itself has taken these names already.
_SITE = """
import numba.core.codegen, numba.core.compiler_machinery, numba.core.environment, numba.core.typing.templates
numba.core.codegen.RenamedLibrary = numba.core.codegen.__dict__.pop("JITCodeLibrary")
numba.core.compiler_machinery.RenamedManager = numba.core.compiler_machinery.__dict__.pop("PassManager")
"""


def changed_numba(folder: Path) -> dict[str, str]:
    """The environment of such processes; `folder` must be kept for them."""
    (folder / "sitecustomize.py").write_text(_SITE)
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
