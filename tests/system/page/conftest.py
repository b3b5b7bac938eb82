"""A Chromium, and a service on the cluster of all tests, for the tests of one file."""

from collections.abc import Iterator
from typing import Any

import pytest
from browser import chromium
from served import service_at

from worker.executors.dask import Dask


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, cluster: Dask) -> Iterator[str]:
    with service_at(tmp_path_factory.mktemp("data"), cluster) as address:
        yield address
