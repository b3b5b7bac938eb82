"""Extras of the package without which some tests are skipped: why, and programs that they bring."""

import os
import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT

#: What only extras bring, by the names under which it is imported.
EXTRAS = ("pyarrow", "obstore", "aiohttp", "IPython")

#: Begins a program that finds none of the packages whose names it reads, as if they were not installed.
WITHOUT = '''
import json, sys

class Without:
    """A finder that does not find what is refused."""

    def __init__(self, finder):
        self._finder = finder

    def __getattr__(self, name):
        return getattr(self._finder, name)

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in refused else self._finder.find_spec(name, path, target)

refused = set(json.loads(sys.stdin.readline()))
sys.meta_path[:] = map(Without, sys.meta_path)
'''


def needs(extra: str) -> str:
    """Why a test is skipped without an extra."""
    return f'needs the extra {extra}: pip install -e ".[test,{extra}]"'


SYSTEM = needs("system")
LINT = needs("lint")


def missing_programs(names: Sequence[str], path: str, packages: str) -> str:
    """Why programs of Debian's packages cannot be started by root here; empty if they can."""
    absent = [name for name in names if shutil.which(name, path=path) is None]
    if absent:
        return f"needs {', '.join(absent)}: apt-get install {packages}"
    return "" if os.geteuid() == 0 else "needs root"


def program(name: str, reason: str) -> str:
    """The path of a program of this environment; skips the test if it is not installed."""
    path = Path(sys.executable).with_name(name)
    if not path.exists():
        pytest.skip(reason)
    return str(path)


def locked() -> dict[str, list[Requirement]]:
    """The pins of the lock file by library; a library can have several, for different Pythons."""
    lock, pins = (ROOT / "requirements.lock").read_text(), dict[str, list[Requirement]]()
    for line in re.findall(r"^([a-z0-9][^\\\n]*==[^\\\n]*)", lock, re.MULTILINE):
        pin = Requirement(line)
        pins.setdefault(canonicalize_name(pin.name), []).append(pin)
    return pins
