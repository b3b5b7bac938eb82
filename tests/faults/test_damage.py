"""Stored results that are flipped, cut or gone: never a silent wrong answer; named, and computed again."""

import contextlib
import os
import random
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from scripted import Scripted, wait_for

from service.api.app import create_app
from service.settings import Settings
from worker import schema, store
from worker.plan import make_plan
from worker.schema import layout
from worker.spec import SweepSpec
from worker.store import chunks as stored
from worker.tasks import run_chunk

#: Of reading alone, and of reading over HTTP and computing again.
TRIALS = int(os.environ.get("BOUNCE_TEST_TRIALS", "200"))
HTTP_TRIALS = TRIALS // 10

#: 48 cells in some ten chunks.
SWEEP: dict[str, Any] = {
    "gamma": {"start": 0.8, "stop": 5.0, "num": 12},
    "omega": [0.5, 0.7],
    "xi": [0.05, 0.26],
    "model": {"kind": "rigid"},
    "settle": 12_000,
    "observe": 20,
    "keep": 8,
}
RAMP = SWEEP | {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}}


class Service:
    """The application on a folder, one job in it, and every answer that the job can give."""

    def __init__(self, client: TestClient, executor: Scripted, folder: Path) -> None:
        self.client, self.executor, self.folder = client, executor, folder

    def submit(self, spec: dict[str, Any]) -> str:
        here = str(self.client.post("/v1/jobs", json=spec).headers["Location"])
        self.wait(here)
        return here

    def wait(self, here: str) -> None:
        wait_for(lambda: self.client.get(here).json()["state"] == "done", lambda: self.client.get(here).text)

    def answers(self, here: str, spec: dict[str, Any]) -> list[Any]:
        """All lines of the grid in all directions, and the thresholds; the answers themselves."""
        directions = ["up", "down"] if "protocol" in spec else ["rest"]
        lines = [
            self.client.get(f"{here}/diagram", params={"omega": omega, "xi": xi, "direction": direction})
            for omega in spec["omega"]
            for xi in spec["xi"]
            for direction in directions
        ]
        return [*lines, *(self.client.get(f"{here}/threshold", params={"xi": xi}) for xi in spec["xi"])]

    def store(self, here: str) -> Path:
        return self.folder / "stores" / f"{here.rsplit('/', 1)[1]}.zarr"


@contextmanager
def running(folder: Path) -> Iterator[Service]:
    executor = Scripted()
    settings = Settings(data=folder, heartbeat_seconds=0.2)
    with TestClient(create_app(settings, executor), base_url="http://localhost") as client:
        yield Service(client, executor, folder)
    executor.close()


def files(url: Path) -> dict[str, bytes]:
    """What is stored; a file that is just being put in its place is not there yet."""
    found = {}
    for path in url.rglob("*"):
        with contextlib.suppress(FileNotFoundError):
            if path.is_file():
                found[str(path.relative_to(url))] = path.read_bytes()
    return found


def flip(path: Path, chance: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def cut(path: Path, chance: random.Random) -> None:
    path.write_bytes(path.read_bytes()[: chance.randrange(path.stat().st_size)])


def delete(path: Path, chance: random.Random) -> None:
    path.unlink()


def harmed(url: Path, chance: random.Random) -> str:
    """Flip a bit of, cut, or delete one stored chunk of one array, at random; gives its address."""
    chunk = chance.choice(sorted(path for path in url.glob("*/c/**/*") if path.is_file()))
    if len(chunk.relative_to(url).parts) < 6:  # coordinates: nothing that is answered comes from them
        return harmed(url, chance)
    chance.choice([flip, cut, delete])(chunk, chance)
    return str(chunk.relative_to(url))


def place_in(address: str) -> store.ChunkCoords:
    """The chunk that a file belongs to."""
    return tuple(map(int, address.split("/")[2:6]))


def test_no_read_of_a_harmed_store_is_silently_wrong(tmp_path: Path):
    chance, spec = random.Random(3), SweepSpec(**RAMP | {"settle": 20})
    plan, url = make_plan(spec, chunk_shape=(1, 1, 4)), tmp_path / "sweep.zarr"
    store.create(str(url), layout(spec, plan.chunk_shape))
    for chunk in plan:
        run_chunk(spec, chunk, str(url))
    names = [array.name for array in schema.arrays(spec)]
    intact = {path: path.read_bytes() for path in url.rglob("*") if path.is_file()}
    for _ in range(TRIALS):
        address = harmed(url, chance)
        with pytest.raises(store.StoreDamaged) as met:
            store.read_chunk(str(url), plan[plan.number(*place_in(address))], names, complete=True)
        assert met.value.chunks == (place_in(address),)
        (url / address).write_bytes(intact[url / address])


@pytest.mark.parametrize("spec", [SWEEP, RAMP], ids=["rest", "ramp"])
def test_queries_never_answer_with_damage_and_it_is_computed_again(tmp_path: Path, spec: dict[str, Any]):
    """Right answers, or 503 that names the chunk, or one that says it is incomplete; soon, right ones."""
    chance = random.Random(4)
    with running(tmp_path) as service:
        here = service.submit(spec)
        expected = [answer.json() for answer in service.answers(here, spec)]
        intact = files(service.store(here))
        for _ in range(HTTP_TRIALS):
            before = len(service.executor.tried)
            address = harmed(service.store(here), chance)
            for answer, right in zip(service.answers(here, spec), expected, strict=True):
                if answer.status_code == 503:
                    assert "chunk" in answer.json()["detail"]
                elif answer.json()["complete"]:  # what is not says so itself
                    assert answer.json() == right, address
            service.wait(here)
            assert len(service.executor.tried) - before <= 1, address
            if files(service.store(here)) != intact:  # in an array or place that no answer read
                assert address.startswith("end_state")
                (service.store(here) / address).write_bytes(intact[address])


@pytest.mark.parametrize("spec", [SWEEP, RAMP], ids=["rest", "ramp"])
def test_at_the_start_every_chunk_is_verified_and_only_damaged_ones_are_computed(
    tmp_path: Path, spec: dict[str, Any]
):
    chance = random.Random(5)
    with running(tmp_path) as service:
        here = service.submit(spec)
        intact = files(service.store(here))
    for _ in range(2):
        addresses = {harmed(service.store(here), chance) for _ in range(4)}
        chunks = {tuple(address.split("/")[2:6]) for address in addresses}
        with running(tmp_path) as service:
            wait_for(lambda here=here, intact=intact: files(service.store(here)) == intact)
            service.wait(here)
            assert len(service.executor.tried) == len(chunks)


def test_a_chunk_in_which_a_ramp_goes_on_is_computed_again_first(tmp_path: Path):
    """The job is half done when the end it goes on from is lost."""
    with running(tmp_path) as service:
        service.executor.script[6] = [ValueError("not yet")] * 3
        here = str(service.client.post("/v1/jobs", json=RAMP).headers["Location"])
        wait_for(lambda: service.client.get(here).json()["state"] == "failed")
        spec = SweepSpec(**RAMP)
        plan = make_plan(spec)
        before = plan[plan[6].after or 0]
        address = stored.key("end_state", 5, layout(spec, plan.chunk_shape).coords(before.slices))
        (service.store(here) / address).unlink()
        service.client.post("/v1/jobs", json=RAMP)
        service.wait(here)
        repaired = files(service.store(here))
    with running(tmp_path / "other") as service:
        assert files(service.store(service.submit(RAMP))) == repaired


def test_a_store_that_is_gone_is_computed_again(tmp_path: Path):
    with running(tmp_path) as service:
        here = service.submit(SWEEP)
        intact = files(service.store(here))
        shutil.rmtree(service.store(here))
        assert all(answer.status_code == 503 for answer in service.answers(here, SWEEP)[:1])
        for _ in range(12):  # a chunk or two with each answer
            service.answers(here, SWEEP)
            service.wait(here)
            if files(service.store(here)) == intact:
                break
        assert files(service.store(here)) == intact
        shutil.rmtree(service.store(here))
    with running(tmp_path) as service:
        wait_for(lambda: files(service.store(here)) == intact)


@pytest.mark.parametrize("content", [b"", b"{}", b'{"zarr_format": 3', None])
def test_a_damaged_description_is_mended_without_computing(tmp_path: Path, content: bytes | None):
    with running(tmp_path) as service:
        here = service.submit(SWEEP)
        intact = files(service.store(here))
    root = service.store(here) / "zarr.json"
    root.unlink() if content is None else root.write_bytes(content)
    (service.store(here) / "gamma" / "c" / "0").unlink()
    with running(tmp_path) as service:
        wait_for(lambda: files(service.store(here)) == intact)
        assert service.executor.tried == []


def test_leftovers_of_an_earlier_life_are_swept(tmp_path: Path):
    with running(tmp_path) as service:
        here = service.submit(SWEEP)
    url = service.store(here)
    partial = url / "outcome" / "c" / "0" / "0" / "0" / "0.0123456789abcdef.partial"
    partial.write_bytes(b"half")
    orphan, kept = url.parent / f"{'0' * 32}.zarr", url.parent / "notes.txt"
    shutil.copytree(url, orphan)
    shutil.copytree(url, f"{url}.deleted-00ff")
    (url.parent / f"{'0' * 32}.zarr.cancelled").touch()
    kept.write_text("somebody's own")
    with running(tmp_path):
        wait_for(lambda: sorted(url.parent.iterdir()) == sorted([url, kept]) and not partial.exists())


def test_stores_beside_an_empty_ledger_are_left_alone(tmp_path: Path):
    with running(tmp_path) as service:
        here = service.submit(SWEEP)
    for path in tmp_path.glob("ledger*"):
        path.unlink()
    with running(tmp_path) as service:
        time.sleep(0.3)
        assert service.store(here).exists()
        assert service.submit(SWEEP) == here
