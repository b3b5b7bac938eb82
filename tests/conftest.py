"""Fixtures and settings of all tests: one kernel cache, one cluster of two worker processes.

The cache is kept between runs in `.numba-cache`, so that only the first run compiles. Tests
depend neither on the program's environment variables, nor on proxies, nor on signals that the calling shell
ignores.
"""

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis
from paths import CACHE, TESTS
from pytest_timeout import timeout_sigalrm

from worker.kernel_cache import use_cache

# Collecting garbage took a seventh of the tests' time: half a million objects stay for good.
gc.set_threshold(50_000, 50)

os.environ["NUMBA_CACHE_DIR"] = str(CACHE)  # of the processes that tests start, too
use_cache()

for name in [name for name in os.environ if name.startswith("BOUNCE_")]:
    if not name.startswith(("BOUNCE_TEST_", "BOUNCE_FUZZ")):
        del os.environ[name]
os.environ["NO_PROXY"] = os.environ["no_proxy"] = "127.0.0.1,localhost,::1"

# A shell starts background jobs of a script with SIGINT ignored, and processes inherit that. Tests send
# SIGINT to processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# nohup ignores SIGHUP. A handler, unlike SIG_IGN, is not inherited by what tests start; it does nothing here.
for number in (signal.SIGHUP, signal.SIGTERM):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, lambda *_: None)

# The same examples every time, however slow the machine: `--hypothesis-profile=explore` looks for others.
hypothesis.register_profile(
    "same", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis.register_profile("explore", hypothesis.get_profile("same"), derandomize=False, print_blob=True)
hypothesis.load_profile("same")


# Called without paths, pytest runs the unit tests and, of the system's, those marked as essential.


def pytest_configure(config: pytest.Config) -> None:
    # As an option, which xdist hands to its processes.
    config.option.only_essential = config.args_source is config.ArgsSource.TESTPATHS or getattr(
        config.option, "only_essential", False
    )


def is_test_of_the_system(path: Path) -> bool:
    return path.name.startswith("test_") and TESTS / "system" in path.parents


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file of the system without an essential test is not even imported."""
    if config.option.only_essential and is_test_of_the_system(collection_path):
        return "mark.essential" not in collection_path.read_text() or None
    return None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.option.only_essential:
        chosen, others = [], []
        for item in items:
            runs = item.get_closest_marker("essential") or not is_test_of_the_system(item.path)
            (chosen if runs else others).append(item)
        items[:] = chosen
        config.hook.pytest_deselected(items=others)
        # Modules are handed out in this order: by size, so that those of the system find compiled kernels.
        tests = Counter(item.path for item in items)
        items.sort(key=lambda item: -tests[item.path])


def pytest_collection_finish() -> None:
    gc.freeze()


def pytest_timeout_set_timer(item: pytest.Item, settings: Any) -> bool | None:
    """A unit test fails after 60 s in which no kernel is compiled, the slower the busier the machine."""
    longer = any(name.startswith(("BOUNCE_TEST_", "KERNEL_EXPLORE")) for name in os.environ)  # asked for
    if longer or TESTS / "unit" not in item.path.parents or item.get_closest_marker("timeout"):
        return None  # as pytest-timeout does
    from kernel.numerics.cache import compilations  # not needed where xdist hands out tests

    left = limit = min(settings.timeout, 60.0)

    def look(*_: Any) -> None:
        nonlocal left
        if not compilations():
            left -= 5.0 / max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
        if left <= 0.0:
            item.cancel_timeout()
            timeout_sigalrm(item, settings._replace(timeout=limit))

    item.cancel_timeout = lambda: signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, 5.0, 5.0)
    return True


@pytest.fixture(scope="session")
def cluster() -> Iterator[Any]:
    """A Dask executor on two worker processes, shared by all tests: leave it running."""
    from worker.executors.dask import Dask  # not needed where xdist hands out tests

    executor = Dask(workers=2)
    yield executor
    executor.close()


@pytest.fixture
def inline() -> Iterator[Any]:
    """An executor that computes in this process."""
    from worker.executors.inline import Inline

    with closing(Inline()) as executor:
        yield executor
