"""Stored bytes that are flipped, truncated or deleted: reported, never returned as data, computed again."""

import errno
import json
import os
import random
import shutil
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from fastapi.testclient import TestClient
from scripted import DEADLINE, Scripted, wait_for
from served import finished, service
from stores import files, store_in
from studies import ADAPTIVE, BASINS, spec_of

from service.cli.doctor import verify
from service.jobs import supervisor
from service.settings import Settings
from worker import store
from worker.store import backend
from worker.store import store as stored
from worker.sweep import SweepSpec, schema
from worker.sweep.plan import make_plan
from worker.sweep.schema import layout
from worker.sweep.task import run_chunk

#: The number of damaged files that are read, and of those that are requested over HTTP.
TRIALS = int(os.environ.get("BOUNCE_TEST_TRIALS", "100"))
HTTP_TRIALS = TRIALS // 10

#: 48 cells in some ten chunks.
SWEEP = spec_of((0.8, 5.0, 12), [0.5, 0.7], [0.05, 0.26], window=(12_000, 20, 8))
RAMP = SWEEP | {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}}


class Service:
    """The application on a data folder, and requests of it."""

    def __init__(self, client: TestClient, executor: Scripted, folder: Path) -> None:
        self.client, self.executor, self.folder = client, executor, folder

    def submit(self, spec: dict[str, Any]) -> str:
        return finished(self.client, spec)

    def wait(self, here: str) -> None:
        wait_for(lambda: self.client.get(here).json()["state"] == "done", lambda: self.client.get(here).text)

    def answers(self, here: str, spec: dict[str, Any]) -> list[Any]:
        """The responses for all lines of the grid in all directions, and for all thresholds."""
        directions = ["up", "down"] if "protocol" in spec else ["rest"]
        lines = [
            self.client.get(f"{here}/diagram", params={"omega": omega, "xi": xi, "direction": direction})
            for omega in spec["omega"]
            for xi in spec["xi"]
            for direction in directions
        ]
        return [*lines, *(self.client.get(f"{here}/threshold", params={"xi": xi}) for xi in spec["xi"])]

    def store(self, here: str) -> Path:
        return store_in(self.folder, here.rsplit("/", 1)[1])


def is_complete(answer: Any) -> bool:
    document = answer.json()
    return bool(document.get("attrs", document)["complete"])


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader is answered after the repair, also on a busy machine."""
    monkeypatch.setattr(supervisor, "REPAIR_SECONDS", DEADLINE)


@contextmanager
def running(folder: Path) -> Iterator[Service]:
    with closing(Scripted()) as executor, service(folder, executor) as client:
        yield Service(client, executor, folder)


def flip(path: Path, chance: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def cut(path: Path, chance: random.Random) -> None:
    path.write_bytes(path.read_bytes()[: chance.randrange(path.stat().st_size)])


def delete(path: Path, chance: random.Random) -> None:
    path.unlink()


def damage(url: Path, chance: random.Random) -> str:
    """Flip a bit of, truncate, or delete one stored chunk of one array; returns its key."""
    chunk = chance.choice(sorted(url.glob("*/c.*")))  # not of a coordinate, which no response reads
    chance.choice([flip, cut, delete])(chunk, chance)
    return str(chunk.relative_to(url))


def coords_of(address: str) -> store.ChunkCoords:
    """The chunk to which a file belongs."""
    return tuple(map(int, address.split(".")[1:5]))


def test_every_read_of_a_damaged_chunk_is_an_error(tmp_path: Path):
    chance, spec = random.Random(3), SweepSpec(**RAMP | {"settle": 20})
    plan, url = make_plan(spec, chunk_shape=(1, 1, 4)), tmp_path / "sweep.zarr"
    store.create(str(url), layout(spec, plan.chunk_shape))
    for chunk in plan:
        run_chunk(spec, chunk, str(url))
    names = [array.name for array in schema.arrays(spec)]
    intact = {path: path.read_bytes() for path in url.rglob("*") if path.is_file()}
    for _ in range(TRIALS):
        address = damage(url, chance)
        with pytest.raises(store.StoreDamaged) as caught:
            store.read_chunk(str(url), plan[plan.number(*coords_of(address))], names, complete=True)
        assert caught.value.chunks == (coords_of(address),)
        (url / address).write_bytes(intact[url / address])


def test_queries_never_return_damaged_bytes_and_repair_them(tmp_path: Path):
    """Each response is right, 503 with the chunk's name, or marked incomplete; all are right in the end."""
    chance, spec = random.Random(4), SWEEP
    with running(tmp_path) as service:
        here = service.submit(spec)
        expected = [answer.json() for answer in service.answers(here, spec)]
        intact = files(service.store(here))
        for _ in range(HTTP_TRIALS):
            before = len(service.executor.tried)
            address = damage(service.store(here), chance)
            for answer, right in zip(service.answers(here, spec), expected, strict=True):
                if answer.status_code == 503:
                    assert "chunk" in answer.json()["detail"]
                elif is_complete(answer):  # an incomplete one is marked so
                    assert answer.json() == right, address
            service.wait(here)
            assert len(service.executor.tried) - before <= 1, address
            if files(service.store(here)) != intact:  # in an array that no response reads
                assert address.startswith("end_state")
                (service.store(here) / address).write_bytes(intact[address])


def swap_a_file(ours: Path, theirs: Path, chance: random.Random) -> None:
    """One array's chunk is that of another job."""
    key = chance.choice(sorted(str(path.relative_to(ours)) for path in ours.glob("*/c.*")))
    shutil.copy(theirs / key, ours / key)


def swap_a_chunk(ours: Path, theirs: Path, chance: random.Random) -> None:
    """All arrays' chunks at one place are those of another job."""
    name = chance.choice(sorted(path.name for path in ours.glob("outcome/c.*")))
    for path in [*ours.glob(f"*/{name}"), *ours.glob(f"*/{name}.*")]:
        shutil.copy(theirs / path.relative_to(ours), path)


def move_a_chunk(ours: Path, theirs: Path, chance: random.Random) -> None:
    """All arrays' chunks are at another place of the same job."""
    names = sorted(path.name for path in ours.glob("outcome/c.*"))
    name, other = chance.sample(names, 2)
    for path in [*ours.glob(f"*/{name}"), *ours.glob(f"*/{name}.*")]:
        shutil.copy(path.with_name(path.name.replace(name, other, 1)), path)


def edit_numbers(ours: Path, theirs: Path, chance: random.Random) -> None:
    """Somebody writes other numbers with zarr: whole and well-formed files."""
    array = zarr.open_group(ours, mode="r+")[chance.choice(["flight_time", "bounces", "outcome"])]
    array[...] = np.asarray(array[...]) + 1  # type: ignore[index]


def edit_type(ours: Path, theirs: Path, chance: random.Random) -> None:
    edit_metadata(ours, chance, data_type=chance.choice(["int64", "float32"]))


def edit_shape(ours: Path, theirs: Path, chance: random.Random) -> None:
    edit_metadata(ours, chance, shape=[10**9] * 4)


def edit_metadata(ours: Path, chance: random.Random, **fields: Any) -> None:
    root = json.loads((ours / "zarr.json").read_text())
    name = chance.choice(["flight_time", "bounces", "outcome"])
    root["consolidated_metadata"]["metadata"][name] |= fields
    (ours / "zarr.json").write_text(json.dumps(root))


def nest(ours: Path, theirs: Path, chance: random.Random) -> None:
    (ours / "zarr.json").write_text('{"attributes":' * 100_000 + "1" + "}" * 100_000)


def swap_metadata(ours: Path, theirs: Path, chance: random.Random) -> None:
    shutil.copy(theirs / "zarr.json", ours / "zarr.json")


def make_folders(ours: Path, theirs: Path, chance: random.Random) -> None:
    """Folders stand in the place of the metadata and a chunk."""
    for path in (ours / "zarr.json", chance.choice(sorted(ours.glob("flight_time/c.*")))):
        path.unlink()
        (path / "inside").mkdir(parents=True)


def swap_everything(ours: Path, theirs: Path, chance: random.Random) -> None:
    shutil.rmtree(ours)
    shutil.copytree(theirs, ours)


def test_files_that_are_not_the_jobs_own_are_never_answered(tmp_path: Path):
    """Each is whole, and would be decoded: a swapped or edited file is damage, and is repaired."""
    chance = random.Random(8)
    harms = [
        swap_a_file, swap_a_chunk, move_a_chunk, edit_numbers, edit_type, edit_shape, nest, swap_metadata,
        swap_everything, make_folders,
    ]  # fmt: skip
    other = SWEEP | {"gamma": SWEEP["gamma"] | {"start": 0.9}}
    with running(tmp_path) as service:
        here, there = service.submit(SWEEP), service.submit(other)
        ours, theirs = service.store(here), service.store(there)
        intact = files(ours)
        keys = ["zarr.json", *sorted(str(path.relative_to(ours)) for path in ours.glob("flight_time/c.*"))]
        expected = [answer.content for answer in service.answers(here, SWEEP)]
        for number in range(HTTP_TRIALS):
            harm = harms[number % len(harms)]
            harm(ours, theirs, chance)
            for answer, right in zip(service.answers(here, SWEEP), expected, strict=True):
                assert answer.status_code == 503 or not is_complete(answer) or answer.content == right
            for key in keys:
                stored = service.client.get(f"{here}/zarr/{key}")
                assert stored.status_code in (404, 503) or stored.content == intact[key], (harm, key)
            for _ in range(12):  # each response finds one or two chunks
                service.wait(here)
                if all(
                    answer.content == right
                    for answer, right in zip(service.answers(here, SWEEP), expected, strict=True)
                ):
                    break
            else:
                raise AssertionError(f"not repaired after {harm.__name__}")
            for key, content in intact.items():  # arrays that no response reads
                if not (ours / key).exists() or (ours / key).read_bytes() != content:
                    (ours / key).write_bytes(content)


def test_until_damage_is_repaired_no_answer_is_complete(tmp_path: Path):
    """Also those that need nothing of the damaged chunk; the job says that it is being repaired."""
    repair = threading.Event()
    with running(tmp_path) as service:
        here = service.submit(SWEEP)
        right = [answer.json() for answer in service.answers(here, SWEEP)]
        assert all(is_complete(answer) for answer in service.answers(here, SWEEP))
        service.executor.before = lambda: repair.wait(DEADLINE)
        address = stored.chunk_key("flight_time", 5, (0, 0, 0, 0))
        (service.store(here) / address).unlink()
        found = service.client.get(f"{here}/diagram", params={"omega": 0.5, "xi": 0.05})
        assert found.status_code == 503
        view = service.client.get(here).json()
        assert (view["state"], view["repairing"], view["finished"]) == ("running", True, None)
        answers = service.answers(here, SWEEP)
        assert [answer.status_code for answer in answers] == [200] * len(answers)
        assert not any(is_complete(answer) for answer in answers)
        for query in ({"format": "png"}, {"format": "csv"}):
            drawn = service.client.get(f"{here}/diagram", params={"omega": 0.7, "xi": 0.26, **query})
            assert (drawn.status_code, drawn.headers["Bounce-Complete"]) == (200, "false")
            assert "ETag" not in drawn.headers
        repair.set()
        service.wait(here)
        assert service.client.get(here).json()["repairing"] is False
        assert [answer.json() for answer in service.answers(here, SWEEP)] == right


@pytest.mark.parametrize(
    ("spec", "array"),
    [
        (BASINS | {"protocol": {"kind": "basin", "rows": 24, "columns": 32}}, "attractor"),
        (ADAPTIVE, "flight_time"),
    ],
    ids=["basins", "adaptive"],
)
def test_of_every_study_only_damaged_chunks_are_computed_again(tmp_path, spec: dict[str, Any], array: str):
    chance = random.Random(6)
    with running(tmp_path) as service:
        here = service.submit(spec)
        intact = files(service.store(here))
        assert len(set(service.executor.tried)) > 2
    addresses = chance.sample(sorted(path for path in intact if path.startswith(f"{array}/c.")), 2)
    for address, harm in zip(addresses, (flip, delete), strict=True):
        harm(service.store(here) / address, chance)
    assert not all(finding.ok for finding in verify(Settings(data=tmp_path), None))
    with running(tmp_path) as service:
        wait_for(lambda: files(service.store(here)) == intact)
        service.wait(here)
        assert len(set(service.executor.tried)) == 2  # perhaps in several slices


def test_the_doctor_goes_on_after_damage_that_cannot_be_removed(tmp_path, monkeypatch):
    with running(tmp_path) as service:
        jobs = [service.submit(SWEEP | {"keep": keep}) for keep in (1, 2)]
        chunks = [service.store(here) / "flight_time/c.0.0.0.0.0" for here in jobs]
    for chunk in chunks:
        chunk.write_bytes(b"")

    def refuse(path: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(backend, "clear", refuse)
    found = [finding.text for finding in verify(Settings(data=tmp_path), None) if not finding.ok]
    assert len(found) == 2
    assert all(str(chunk.parents[1]) in "".join(found) for chunk in chunks)


def test_a_lost_predecessor_on_a_ramp_is_computed_again_first(tmp_path: Path):
    """The job is half done when the end state from which it continues is lost."""
    with running(tmp_path) as service:
        service.executor.script[6] = [ValueError("not yet")] * 3
        here = str(service.client.post("/v1/jobs", json=RAMP).headers["Location"])
        wait_for(lambda: service.client.get(here).json()["state"] == "failed")
        spec = SweepSpec(**RAMP)
        plan = make_plan(spec)
        before = plan[plan[6].after or 0]
        address = stored.chunk_key("end_state", 5, layout(spec, plan.chunk_shape).coords(before.slices))
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
        for _ in range(12):  # each response finds one or two chunks
            service.answers(here, SWEEP)
            service.wait(here)
            if files(service.store(here)) == intact:
                break
        assert files(service.store(here)) == intact


@pytest.mark.parametrize("query", ["audit?cells=21", "threshold?tolerance=1e-3&xi=0.05"])
def test_what_workers_read_is_repaired_too(tmp_path: Path, query: str):
    with running(tmp_path) as service:
        here = service.submit(SWEEP | {"settle": 100})
        (service.store(here) / "zarr.json").unlink()

        def status() -> int:
            return int(service.client.get(f"{here}/{query}").status_code)

        statuses: list[int] = []
        wait_for(lambda: statuses.append(status()) or statuses[-1] != 202)
        assert statuses[-1] == 503
        wait_for(lambda: statuses.append(status()) or statuses[-1] != 202)
        assert statuses[-1] == 200


def test_metadata_that_an_unfinished_job_lost_is_damage(tmp_path: Path):
    with running(tmp_path) as service:
        service.executor.script[3] = [RuntimeError("fails")] * 99
        here = str(service.client.post("/v1/jobs", json=SWEEP).headers["Location"])
        wait_for(lambda: service.client.get(here).json()["state"] == "failed")
        answers = [answer.json() for answer in service.answers(here, SWEEP)]
        root = service.store(here) / "zarr.json"
        for read in ("diagram?omega=0.5&xi=0.05", "zarr/zarr.json"):
            root.unlink()
            assert service.client.get(f"{here}/{read}").status_code == 503
        assert [answer.json() for answer in service.answers(here, SWEEP)] == answers


@pytest.mark.parametrize("content", [b'{"zarr_format": 3', None])
def test_damaged_metadata_is_repaired_without_computing(tmp_path: Path, content: bytes | None):
    with running(tmp_path) as service:
        here = service.submit(SWEEP)
        intact = files(service.store(here))
    root = service.store(here) / "zarr.json"
    root.unlink() if content is None else root.write_bytes(content)
    (service.store(here) / "gamma" / "c" / "0").unlink()
    with running(tmp_path) as service:
        assert service.client.get(f"{here}/zarr/gamma/c/0").status_code == 503
        assert files(service.store(here)) == intact
        assert service.executor.tried == []
