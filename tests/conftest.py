"""What all tests share: one kernel cache, one cluster of two worker processes, small sweeps.

The cache is claimed before anything imports a kernel, and kept between runs (`.numba-cache`,
not tracked), so that only the first run compiles.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from worker.warm import claim_cache, warm

CACHE = Path(__file__).parents[1] / ".numba-cache"
claim_cache(CACHE)

from worker.executors import Dask  # noqa: E402 - the cache comes first
from worker.spec import SweepSpec  # noqa: E402


@pytest.fixture(scope="session")
def cluster() -> Iterator[Dask]:
    """A Dask executor on two worker processes, for everybody: leave it running."""
    warm(CACHE)  # so that on a fresh machine one process compiles instead of three
    executor = Dask(workers=2, kernel_cache=CACHE)
    yield executor
    executor.close()


@pytest.fixture
def small_spec() -> Callable[..., SweepSpec]:
    """Makes sweeps of 2 x 3 x 10 cheap cells; any field can be given."""

    def make(**given: Any) -> SweepSpec:
        fields: dict[str, Any] = {
            "gamma": {"start": 0.5, "stop": 5.0, "num": 10},
            "omega": [0.5, 0.7, 1.0],
            "xi": [0.05, 0.26],
            "model": {"kind": "rigid"},
            "settle": 20,
            "observe": 20,
            "keep": 8,
        }
        return SweepSpec(**(fields | given))

    return make
