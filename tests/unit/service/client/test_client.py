"""The client against the real application, in this process."""

import io
import json
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripted import TWO_LINES, Held, Scripted, sweep, wait_for
from served import service
from tables import for_each

from kernel.params import Outcome
from service.client import (
    BounceError,
    Client,
    InvalidSpecification,
    Job,
    JobFailed,
    NotComputedYet,
    NotFound,
    WaitTimeout,
)
from service.client.models import Problem
from worker.executors.base import Executor
from worker.executors.inline import Inline
from worker.spec.axes import Range
from worker.spec.contact_models import Rigid
from worker.sweep import SweepSpec

SPEC: dict[str, Any] = {**TWO_LINES, "name": "coarse <figure 2>", "settle": 100}


@contextmanager
def serving(folder: Path, executor: Executor, **options: Any) -> Iterator[Client]:
    with service(folder, executor, **options) as http, Client("http://localhost", http=http) as client:
        yield client
    executor.close()


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with serving(tmp_path_factory.mktemp("data"), Inline()) as client:
        yield client


@pytest.fixture(scope="module")
def job(client: Client) -> Job:
    """A job that is done."""
    return client.submit(SPEC).wait(progress=False)


# Submitting


def test_the_same_sweep_is_the_same_job_in_every_form(client: Client, job: Job, tmp_path: Path):
    as_json = tmp_path / "sweep.json"
    as_json.write_text(json.dumps(SPEC))
    as_toml = tmp_path / "sweep.toml"
    as_toml.write_text(
        'omega = [0.5, 0.7]\nxi = 0.26\nsettle = 100\nobserve = 20\nkeep = 8\nmodel = {kind = "rigid"}\n'
        "gamma = {start = 0.5, stop = 5.0, num = 46}\n"
    )
    in_numpy = SPEC | {"omega": np.array([0.5, 0.7]), "xi": np.float64(0.26), "keep": np.int64(8)}
    in_parts = SPEC | {"gamma": Range(start=0.5, stop=5.0, num=46), "model": Rigid()}
    for form in (SPEC, as_json, str(as_json), as_toml, in_numpy, in_parts, SweepSpec.parse(SPEC)):
        assert client.submit(form).id == job.id


@for_each(("change", "field", "rule"), [
    ({"omega": -1.0}, "omega", "at least"),
    ({"gama": 1.0}, "gama", "not a field"),
    ({"xi": float("nan")}, "xi", "finite"),
    ({"omega": {0.5, 0.7}}, "omega", "not set"),
])  # fmt: skip
def test_a_bad_specification_names_field_and_rule(client: Client, change: dict, field: str, rule: str):
    with pytest.raises(InvalidSpecification, match=rule) as caught:
        client.submit(SPEC | change)
    assert [name for name, *_ in caught.value.fields] == [field]
    assert caught.value.problem.status == caught.value.status == 422


def test_an_unreadable_file_is_named(client: Client, tmp_path: Path):
    (tmp_path / "broken.json").write_bytes(b'{"gamma": ')
    for name, word in (("missing.json", "No such file"), ("broken.json", "not JSON")):
        with pytest.raises(InvalidSpecification, match=word) as caught:
            client.submit(tmp_path / name)
        assert name in str(caught.value)


# Jobs


@for_each("id", ["0" * 32, "", "..", "../healthz", "x" * 32, "A" * 32, "\ud800", "a" * 33])
def test_an_unknown_id_is_not_found(client: Client, id: str):
    with pytest.raises(NotFound, match="no job has the id") as caught:
        client.job(id)
    assert caught.value.status == 404


def test_waiting_follows_a_job_to_its_end(tmp_path: Path):
    held = Held()
    with serving(tmp_path, held) as client:
        job = client.submit(sweep())
        wait_for(held.held)
        seen = []

        def follow(job: Job) -> None:
            seen.append((job.state, job.progress.cells_done))
            held.let_go_all()

        assert job.wait(progress=follow) is job
        assert seen[0] == ("queued", 0)
        assert seen[-1] == ("done", 60)
        assert seen == sorted(seen, key=lambda status: status[1])


def test_a_wait_ends_at_its_timeout_and_the_job_continues(tmp_path: Path):
    with serving(tmp_path, Held()) as client:
        job = client.submit(sweep())
        with pytest.raises(WaitTimeout, match="the job continues") as caught:
            job.wait(progress=False, timeout=0.2)
        assert caught.value.job is job
        assert isinstance(caught.value, TimeoutError)
        assert not job.finished
        with pytest.raises(WaitTimeout):
            job.wait(progress=False, timeout=0)
        with pytest.raises(WaitTimeout):
            next(client.as_completed([job], timeout=0.1))


def test_specifications_are_mapped_to_jobs_few_at_once(client: Client):
    specs = [SPEC | {"gamma": [1.4, 1.5 + 0.01 * i]} for i in range(5)]
    submitted: list[int] = []

    def counted() -> Iterator[dict[str, Any]]:
        for i, spec in enumerate(specs):
            submitted.append(i)
            yield spec

    jobs = client.map(counted(), at_once=2)
    assert submitted == []
    first = next(jobs)
    assert first.state == "done"
    assert submitted == [0, 1]
    ids = [first.id, *(job.id for job in jobs)]
    assert ids == [client.submit(spec).id for spec in specs]
    with pytest.raises(BounceError, match="at_once: must be at least 1"):
        next(client.map(specs, at_once=0))


def test_a_failed_job_says_why(tmp_path: Path):
    script = {0: [ValueError("the roof fell in")] * 99}
    with serving(tmp_path, Scripted(script), failed_chunks=1) as client:
        with pytest.raises(JobFailed, match="the roof fell in") as caught:
            client.submit(sweep()).wait(progress=False)
        assert "the roof fell in" in caught.value.job.error


# Results


def test_every_variable_has_attributes_and_can_be_stored(client: Client, job: Job, tmp_path: Path):
    for dataset in (job.diagram(omega=0.5), job.threshold(), client.orbits(0.5, 0.26, modes="1-1")):
        assert dataset.attrs["Conventions"].startswith("CF-")
        for name, variable in dataset.variables.items():
            assert variable.attrs["long_name"], name
            assert variable.dtype.kind == "U" or {"units", "flag_meanings"} & set(variable.attrs), name
        dataset.to_zarr(tmp_path / f"{len(dataset)}.zarr", zarr_format=2, consolidated=True)
    (flags,) = {len(text.split()) for text in (job.diagram(omega=0.5).outcome.flag_meanings,)}
    assert flags == len(job.diagram(omega=0.5).outcome.flag_values) == len(Outcome)


# How things look, and what is exported


def test_an_error_is_read_in_the_process_that_it_is_sent_to():
    for error in (NotFound(Problem(status=404, title="t", detail="d")), NotComputedYet(1, 2, 3.0)):
        sent = io.BytesIO()
        pickler = pickle.Pickler(sent)
        pickler.dispatch_table = {}  # without what distributed adds, which answering processes lack
        pickler.dump(error)
        again = pickle.loads(sent.getvalue())
        assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))
