"""What all tests share: one kernel cache, one cluster of two worker processes, small sweeps.

The cache is claimed before anything imports a kernel, and kept between runs (`.numba-cache`,
not tracked), so that only the first run compiles. What the environment says to the program, and
proxies on the way to this machine itself, are none of the tests' business.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis
from paths import CACHE

from worker.kernel_cache import claim_cache, warm

claim_cache(CACHE)

from scripted import small  # noqa: E402 - the cache comes first

from worker.executors.dask import Dask  # noqa: E402
from worker.executors.inline import Inline  # noqa: E402
from worker.spec import SweepSpec  # noqa: E402

for name in [name for name in os.environ if name.startswith("BOUNCE_")]:
    if not name.startswith(("BOUNCE_TEST_", "BOUNCE_FUZZ")):
        del os.environ[name]
os.environ["NO_PROXY"] = os.environ["no_proxy"] = "127.0.0.1,localhost,::1"

# The same examples every time, however slow the machine: `--hypothesis-profile=explore` looks for others.
hypothesis.register_profile(
    "same", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis.register_profile("explore", hypothesis.get_profile("same"), derandomize=False, print_blob=True)
hypothesis.load_profile("same")


@pytest.fixture(scope="session")
def cluster() -> Iterator[Dask]:
    """A Dask executor on two worker processes, for everybody: leave it running."""
    warm(CACHE)  # so that on a fresh machine one process compiles instead of three
    executor = Dask(workers=2, kernel_cache=CACHE)
    yield executor
    executor.close()


@pytest.fixture
def inline() -> Iterator[Inline]:
    """An executor that computes in this process."""
    with closing(Inline()) as executor:
        yield executor


@pytest.fixture(scope="session")
def small_spec() -> Callable[..., SweepSpec]:
    """Makes sweeps of 2 x 3 x 10 cheap cells; any field can be given."""
    return small
