"""Jobs whose model a worker chooses: recorded before anything is computed, shown, and reproducible."""

import io
import json
import re
import threading
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scripted import Held, wait_for
from served import computing, finished, get, service
from stores import store_in
from studies import spec_of

from worker import store
from worker.executors.base import ClusterLost, WorkerDied
from worker.executors.inline import Inline

AUTO = {"kind": "auto", "tolerance": 1e-3, "restitution": 0.0, "penetration": 1e-6}
SWEEP = spec_of((0.5, 5.0, 46), 0.5, 0.26, name="auto", model=AUTO, keep=8)
FIELDS = ("flight_time", "takeoff_phase", "outcome", "bounces", "periods")


class Unlucky(Inline):
    """Calls fail with these errors, one after the other, before they succeed."""

    def __init__(self, *errors: Exception) -> None:
        super().__init__()
        self.errors, self.calls = list(errors), 0

    def call(self, function: Any, *arguments: Any) -> Any:
        self.calls += 1
        return super().call(self._raise if self.errors else function, *arguments)

    def _raise(self, *_: Any) -> None:
        raise self.errors.pop(0)


class Undecided(Held):
    """Never chooses; `choosing` is set once it should."""

    def __init__(self) -> None:
        super().__init__()
        self.choosing = threading.Event()

    def call(self, *_: Any) -> "Future[Any]":
        self.choosing.set()
        return super().call()


def test_a_choice_for_a_job_that_was_cancelled_occupies_no_place(tmp_path: Path):
    undecided = Undecided()
    with service(tmp_path, undecided, active_jobs=1) as client:
        here = client.post("/v1/jobs", json=SWEEP).headers["Location"]
        wait_for(undecided.choosing.is_set)
        client.post(f"{here}/cancel")
        other = client.post("/v1/jobs", json=SWEEP | {"model": {"kind": "rigid"}}).headers["Location"]
        wait_for(lambda: client.get(other).json()["state"] == "running")


def test_more_jobs_than_places_choose_at_once_and_all_are_computed(tmp_path: Path):
    with computing(tmp_path, active_jobs=1) as client:
        sweeps = [SWEEP | {"omega": 0.5 + 0.01 * number} for number in range(3)]
        places = [client.post("/v1/jobs", json=each).headers["Location"] for each in sweeps]
        wait_for(lambda: all(get(client, here)["state"] == "done" for here in places))


def test_job_and_store_show_the_choice_and_have_the_numbers_of_the_model_chosen(tmp_path: Path):
    with computing(tmp_path) as client:
        here = finished(client, SWEEP)
        job = get(client, here)
        picture = Image.open(io.BytesIO(client.get(f"{here}/diagram?format=png").content))
        page = client.get(f"{here}/export?format=html").text
        rigid = get(client, finished(client, SWEEP | {"model": {"kind": "rigid", "restitution": 0.0}}))
    choice = job["choice"]
    assert (job["state"], choice["model"], rigid["choice"]) == ("done", "rigid", None)
    assert choice["reason"].startswith("rigid: the cheapest within 0.001 rad of exact soft in 95% of the")
    assert [row["model"] for row in choice["table"]] == ["ball", "rigid", "soft"]
    assert all(row["measured"] > 0.0 and row["cells"] == 46 for row in choice["table"])
    shown = json.loads(re.search('id="shared">(.*?)</script>', page)[1])["job"]  # type: ignore[index]
    told = json.loads(picture.text["Description"])["spec"]  # type: ignore[attr-defined]
    assert shown["spec"] == json.loads(told) == job["spec"]  # which has the job's id
    assert (shown["choice"]["reason"], shown["choice"]["model"]) == (choice["reason"], "rigid")
    auto, other = (str(store_in(tmp_path, each["id"])) for each in (job, rigid))
    attributes = store.read_attrs(auto)
    assert (attributes["model"], attributes["choice"]["reason"]) == ("rigid", choice["reason"])
    assert "measured" not in json.dumps(attributes["choice"])  # no timings
    assert attributes["spec"]["model"]["kind"] == job["spec"]["model"]["kind"] == "auto"
    one, two = (store.read_slice(url, FIELDS) for url in (auto, other))
    assert one["flight_time"].shape == (1, 1, 1, 46, 8)
    for name in FIELDS:
        np.testing.assert_array_equal(one[name], two[name])


def test_a_choice_whose_worker_or_cluster_is_lost_is_made_again(tmp_path: Path):
    errors = WorkerDied("no memory"), ClusterLost("no scheduler"), ClusterLost("none"), WorkerDied("again")
    with closing(Unlucky(*errors)) as executor, service(tmp_path, executor) as client:
        assert get(client, finished(client, SWEEP))["choice"]["model"] == "rigid"
    assert executor.calls == 5


def test_a_choice_is_remembered_through_a_restart_before_the_first_chunk(tmp_path: Path):
    """The service stops between the two; the next one computes with the recorded choice."""

    class Refusing(Unlucky):
        def submit(self, *_: Any, **__: Any) -> Any:
            raise ClusterLost("nobody computes")

    with closing(Refusing()) as executor, service(tmp_path, executor) as client:
        here = client.post("/v1/jobs", json=SWEEP).headers["Location"]
        wait_for(lambda: client.get(here).json()["state"] == "running")
        chosen = client.get(here).json()["choice"]
    with closing(Unlucky()) as executor, service(tmp_path, executor) as client:
        job = get(client, finished(client, SWEEP))
    assert executor.calls == 0
    assert (job["state"], job["choice"]) == ("done", chosen)
