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

from worker.kernel_cache import use_cache

use_cache(CACHE)

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

#: Test files that need neither a cluster nor a service in a process of its own: `pytest -m fast` runs them
#: in less than a minute.
FAST = frozenset(
    TESTS / file
    for file in (
        "kernel/test_golden.py",
        "kernel/test_lanes.py",
        "kernel/test_modes.py",
        "kernel/test_ramp.py",
        "kernel/test_resting.py",
        "kernel/test_rigid.py",
        "kernel/test_settle.py",
        "kernel/test_stepped.py",
        "kernel/test_threshold.py",
        "kernel/test_validation.py",
        "worker/test_model_selection.py",
        "worker/test_plan.py",
        "worker/test_spec.py",
        "worker/test_store.py",
        "worker/test_tasks.py",
        "service/test_job_model.py",
        "service/test_ledger.py",
        "service/test_pictures.py",
        "service/test_queries.py",
        "service/test_ready_queue.py",
        "service/test_trajectories.py",
        "service/test_transport.py",
        "faults/test_earlier_release.py",
        "page/test_page.py",
        "test_architecture.py",
    )
)


def pytest_configure() -> None:
    missing = sorted(str(file) for file in FAST if not file.exists())
    if missing:
        raise pytest.UsageError(f"tests/conftest.py lists fast tests that do not exist: {missing}")


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path in FAST:
            item.add_marker(pytest.mark.fast)


@pytest.fixture(scope="session")
def cluster() -> Iterator[Dask]:
    """A Dask executor on two worker processes, shared by all tests: leave it running."""
    use_cache(CACHE)
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
