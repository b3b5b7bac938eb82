"""Fixtures and settings of all tests: one kernel cache, one cluster of two worker processes, small sweeps.

The cache is claimed before anything imports a kernel, and kept between runs in `.numba-cache`, so that only
the first run compiles. Tests depend neither on the program's environment variables, nor on proxies, nor on
signals that the calling shell ignores.
"""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis
from paths import CACHE, TESTS

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

# A shell starts background jobs of a script with SIGINT ignored, and processes inherit that. Tests send
# SIGINT to processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time, however slow the machine: `--hypothesis-profile=explore` looks for others.
hypothesis.register_profile(
    "same", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis.register_profile("explore", hypothesis.get_profile("same"), derandomize=False, print_blob=True)
hypothesis.load_profile("same")

SYSTEM = TESTS / "system"


def pytest_configure(config: pytest.Config) -> None:
    # As an option, which xdist hands to its processes.
    if config.args_source is config.ArgsSource.TESTPATHS:
        config.option.only_essential = True


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Called without paths, pytest runs the unit tests and the essential ones of the system."""
    if getattr(config.option, "only_essential", False):
        left_out = [
            item
            for item in items
            if item.path.is_relative_to(SYSTEM) and item.get_closest_marker("essential") is None
        ]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]


@pytest.fixture(scope="session")
def cluster() -> Iterator[Dask]:
    """A Dask executor on two worker processes, shared by all tests: leave it running."""
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
