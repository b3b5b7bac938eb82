"""A service that computes in this process, one for each module, and its two clients."""

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient
from served import computing

from service.client import Client


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with computing(tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.fixture(scope="module")
def python_client(client: TestClient) -> Client:
    return Client("http://localhost", http=client)
