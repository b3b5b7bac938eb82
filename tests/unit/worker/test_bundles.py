"""Tasks submitted together, and specifications sent once."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from worker import store
from worker.executors import sent_specs
from worker.executors.bundles import Bundles, Call
from worker.executors.sent_specs import Reference, SpecReferences
from worker.spec import SweepSpec
from worker.studies import study_of


def small_spec(**more: Any) -> SweepSpec:
    fields = {"gamma": [1.2, 2.5, 3.1], "omega": 0.5, "xi": [0.05, 0.26], "model": {"kind": "rigid"}}
    return SweepSpec(**(fields | {"settle": 10, "observe": 5, "keep": 4} | more))


class Recording:
    """A client that notes what is submitted, one entry for each message."""

    def __init__(self) -> None:
        self.messages: list[tuple[list[Any], dict[str, Any]]] = []  # what its tasks return, and options

    def map(self, function: Any, calls: Any, **options: Any) -> list[str]:
        results = [function(call) for call in calls]
        if "bad" in results:
            raise ValueError("not this one")
        self.messages.append((results, options))
        return [f"future of {result}" for result in results]


def submit(calls: list[Call], client: Recording | None = None) -> tuple[Recording, list[Any]]:
    client, bundles = client or Recording(), Bundles()

    async def run() -> tuple[Recording, list[Any]]:
        adding = [bundles.add(client, call) for call in calls]
        return client, await asyncio.gather(*adding, return_exceptions=True)

    return asyncio.run(run())


def test_calls_of_one_moment_are_one_message():
    client, futures = submit([Call((abs, -i), priority=-100.5 - i / 100) for i in range(20)])
    [(results, options)] = client.messages
    assert results == list(range(20))
    assert options == {"key": "run_if_admitted", "pure": False, "priority": -100.5, "workers": None}
    assert futures == [f"future of {result}" for result in results]


def test_calls_that_differ_in_urgency_or_workers_are_not():
    calls = [
        Call((abs, 1), 0.0),
        Call((abs, 2), -50.0),
        Call((abs, 3), -50.0, ("a",)),
        Call((max, 4, 5), 0.0),
    ]
    client, futures = submit(calls)
    assert sorted(results for results, _ in client.messages) == [[1, 5], [2], [3]]
    assert ["a"] in [options["workers"] for _, options in client.messages]
    assert futures == [f"future of {result}" for result in (1, 2, 3, 5)]


@pytest.fixture
def long_spec() -> SweepSpec:
    return small_spec(gamma=[round(1.0 + i / 1000, 6) for i in range(1000)])


def stored(spec: Any, folder: Path) -> str:
    url = str(folder / "sweep.zarr")
    store.create(url, study_of(spec).variables(spec, study_of(spec).plan(spec).chunk_shape))
    return url


def test_a_long_specification_is_written_once_and_read_by_its_digest(long_spec: SweepSpec, tmp_path: Path):
    url, specs = stored(long_spec, tmp_path), SpecReferences()
    sent = specs.sent(long_spec, url)
    assert isinstance(sent, Reference)
    assert specs.sent(long_spec, url) is sent
    assert sent_specs._read_spec(sent) == long_spec
    [file] = Path(url).glob(".spec-*")
    file.write_bytes(b"{}")
    sent_specs._read_spec.cache_clear()
    with pytest.raises(store.StoreMissing, match="specification is not there"):
        sent_specs._read_spec(sent)


def test_a_short_one_is_sent_whole_and_so_is_one_that_cannot_be_written(long_spec: SweepSpec, tmp_path: Path):
    short = small_spec()
    assert SpecReferences().sent(short, stored(short, tmp_path)) is short
    assert SpecReferences().sent(long_spec, str(tmp_path / "nowhere.zarr")) is long_spec
