"""Paths of the project and of the tests' files."""

from pathlib import Path

TESTS = Path(__file__).parents[1]
SUPPORT = TESTS / "support"
GOLDEN = TESTS / "golden"
ROOT = TESTS.parent

#: Compiled kernels, kept between runs.
CACHE = ROOT / ".numba-cache"
