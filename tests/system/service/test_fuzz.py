"""Generated requests: no response is a 500, and every response is as the API document says.

A hundred and fifty requests by default; a long run:

    BOUNCE_FUZZ=5000 pytest tests/system/service/test_fuzz.py --timeout 3600
"""

import contextlib
import os
from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any, NamedTuple

import httpx2
import pytest
from extras import SYSTEM
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import FlakyStrategyDefinition
from scripted import DEADLINE
from served import computing_at, done, service_at
from studies import spec_of

from worker.executors.inline import Inline
from worker.study import ChunkReport

pytest.importorskip("schemathesis", reason=SYSTEM)
import requests
import schemathesis

# Loaded here, not when it is needed: Python 3.11 cannot compile modules while other threads do.
import schemathesis.specs.openapi.schemas
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

#: Seconds for a response on a busy machine.
TIMEOUT = 60
CASES = int(os.environ.get("BOUNCE_FUZZ", "150"))

DONE = spec_of((0.6, 1.4, 9), [0.5, 0.6], 0.26, ramp="both", window=(5, 5, 4))

CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]


def examples(count: int, **options: Any) -> settings:
    return settings(
        max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck),
        phases=(Phase.generate,), **options,
    )  # fmt: skip


#: Sequences per seed: responses depend on earlier requests, and hypothesis gives up if the same draws lead to
#: different ones.
AT_A_TIME = 4


class Idle(Inline):
    """Computes no chunk: generated sweeps may be long."""

    def submit(self, *_: Any, **__: Any) -> "Future[ChunkReport]":
        return Future()


class Api(NamedTuple):
    """A service with one done job and one that never ends."""

    address: str
    done: str
    queued: str
    schema: Any


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    folder, idle = tmp_path_factory.mktemp("data"), Idle()
    with computing_at(folder) as address:
        finished_job = done(address, DONE)
    caps = {"max_queue": 100_000, "trajectory_seconds": 0.02, "body_seconds": 2.0}
    with (
        service_at(folder, idle, **caps) as address,
        httpx2.Client(base_url=address, timeout=DEADLINE) as client,
    ):
        queued = client.post("/v1/jobs", json={**DONE, "settle": 6}).json()["id"]
        schema = schemathesis.openapi.from_url(f"{address}/openapi.json")
        yield Api(address, finished_job, queued, schema)
    idle.close()


def requests_of(api: Api) -> st.SearchStrategy[Any]:
    """Valid and invalid requests to every operation; most of those with a job id use one that exists."""
    operations = [result.ok() for result in api.schema.get_all_operations()]
    modes = (GenerationMode.POSITIVE, GenerationMode.NEGATIVE)
    cases = st.one_of(
        [operation.as_strategy(generation_mode=mode) for operation in operations for mode in modes]
    )

    def named(pair: tuple[Any, str | None]) -> Any:
        case, job = pair
        if job is None or "job_id" not in (case.path_parameters or {}):
            return case
        if case.method.upper() == "DELETE" or (case.path.endswith("/events") and job != api.done):
            return case  # keep the jobs; the stream of an unfinished job never ends
        case.path_parameters["job_id"] = job
        return case

    return st.tuples(cases, st.sampled_from([api.done, api.done, api.queued, None])).map(named)


def test_single_requests_are_answered_as_documented(api: Api):
    session = requests.Session()

    @examples(CASES)
    @given(requests_of(api))
    def check(case: Any) -> None:
        response = case.call(session=session, timeout=DEADLINE)
        case.validate_response(response, checks=CHECKS)

    check()
    session.close()
    assert requests.get(f"{api.address}/v1/jobs/{api.done}", timeout=DEADLINE).json()["state"] == "done"


def test_sequences_of_requests_are_answered_as_documented(api: Api):
    """Ids in responses are used in later requests, by the links of the API document."""
    schema = api.schema.exclude(path_regex="/events$")  # an unfinished job's never end
    machine = schema.as_state_machine()
    machine.validate_response = lambda self, response, case, additional_checks=(), **rest: (
        case.validate_response(response, checks=CHECKS)
    )
    machine.get_call_kwargs = lambda self, case: {"timeout": TIMEOUT}
    machine.TestCase.settings = examples(AT_A_TIME, stateful_step_count=12)
    for number in range(max(CASES // 60 // AT_A_TIME, 1)):
        seed(number)(machine)
        with contextlib.suppress(FlakyStrategyDefinition):
            machine.TestCase().runTest()
