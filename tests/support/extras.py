"""Extras of the package without which some tests are skipped: why, and programs that they bring."""

import sys
from pathlib import Path

import pytest

#: What only extras bring, by the names under which it is imported.
EXTRAS = ("obstore", "aiohttp", "IPython")


def needs(extra: str) -> str:
    """Why a test is skipped without an extra."""
    return f'needs the extra {extra}: pip install -e ".[test,{extra}]"'


SYSTEM = needs("system")
LINT = needs("lint")


def program(name: str, reason: str) -> str:
    """The path of a program of this environment; skips the test if it is not installed."""
    path = Path(sys.executable).with_name(name)
    if not path.exists():
        pytest.skip(reason)
    return str(path)
