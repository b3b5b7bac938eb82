"""Answers of the service about small jobs of every kind, as they are and as the client reads them.

All numbers have to be those of tests/golden/answers.json;
`python tests/unit/service/views/test_answers.py` writes that file anew. The cells are at rest or on
cycles: the last digits of chaotic ones would depend on the machine.
"""

import csv
import json
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
import xarray
from fastapi.testclient import TestClient

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[3] / "support"), str(Path(__file__).parents[4])]

    from worker.kernel_cache import use_cache

    use_cache()  # before kernels are declared below

from json_results import from_json
from paths import GOLDEN, ROOT
from scripted import wait_for
from served import computing, finished
from tables import for_each

from service.api.capacity import Activity, Capacity, Lease
from service.client import Client
from worker.studies import parse, study_of

ANSWERS: Final = GOLDEN / "answers.json"
_RIGID: Final[dict[str, Any]] = {"xi": 0.26, "model": {"kind": "rigid"}}
SPECS: Final[dict[str, dict[str, Any]]] = {
    "rest": _RIGID | {"gamma": {"start": 0.8, "stop": 2.6, "num": 13}, "omega": 0.5, "exponents": 1},
    "ramp": _RIGID | {
        "gamma": {"start": 0.6, "stop": 1.6, "num": 11}, "omega": [0.5, 0.7, 1.0], "xi": [0.05, 0.26],
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}, "settle": 60, "observe": 20,
        "keep": 8,
    },
    "adaptive": _RIGID | {
        "gamma": {"start": 0.6, "stop": 2.6, "num": 33}, "omega": {"start": 0.4, "stop": 0.6, "num": 33},
        "observe": 40, "keep": 4, "refine": {"by": "mode", "coarsest": 8},
    },
    "basins": _RIGID | {
        "gamma": [1.27, 2.3], "omega": 0.5, "protocol": {"kind": "basin", "rows": 8, "columns": 8},
        "exponents": 1,
    },
    "multistability": _RIGID | {
        "gamma": [1.2, 1.4, 2.2, 2.4], "omega": [0.5, 0.6], "protocol": {"kind": "multistability"},
        "settle": 300, "observe": 60,
    },
    "orbits": {
        "protocol": {"kind": "orbits"}, "omega": [0.5, 0.6], "xi": [0.0, 0.05], "points": 40, "events": 6,
    },
    "soft": {
        "gamma": [1.2, 1.5], "omega": 0.5, "xi": 0.26,
        "model": {"kind": "soft", "penetration": 1e-3, "restitution": 0.01, "adhesive": True},
    },
    "ball": {"gamma": [1.2, 3.4], "omega": 0.5, "xi": 0.26, "model": {"kind": "ball", "restitution": 0.1}},
}  # fmt: skip
#: Job, its document, and the query.
QUERIES: Final[tuple[tuple[str, str, dict[str, Any]], ...]] = (
    ("rest", "diagram", {}),
    ("rest", "diagram", {"every": 3, "min_flight": 4.5}),
    ("rest", "diagram", {"format": "csv"}),
    ("rest", "orbits", {"gamma_max": 3.0}),
    ("rest", "diagram", {"start": 1.0, "stop": 2.0}),
    ("rest", "diagram", {"start": 1.0, "stop": 2.0, "every": 2, "format": "csv"}),
    ("rest", "trajectory", {"gamma": 1.5, "periods": 2, "samples": 12}),
    ("ramp", "diagram", {"omega": 0.7, "xi": 0.05, "direction": "down"}),
    ("ramp", "diagram", {"along": "omega", "gamma": 1.4, "xi": 0.05, "format": "csv"}),
    ("ramp", "threshold", {"xi": 0.05}),
    ("ramp", "threshold", {"xi": 0.26, "tolerance": 1e-3, "predict": "none"}),
    ("ramp", "modes", {"xi": 0.05, "direction": "down"}),
    ("ramp", "modes", {"xi": 0.26, "every": 2, "min_flight": 5.0}),
    ("ramp", "modes", {"xi": 0.26}),
    ("adaptive", "modes", {}),
    ("adaptive", "modes", {"color": "multiplier"}),
    ("adaptive", "diagram", {"omega": 0.5}),
    ("adaptive", "modes", {"gamma_start": 1.0, "gamma_stop": 2.0, "omega_start": 0.45}),
    ("basins", "basins", {"gamma": 1.27}),
    ("basins", "basins", {"gamma": 2.3}),
    ("basins", "trajectory", {"gamma": 1.27, "attractor": 1, "periods": 1, "samples": 8}),
    ("multistability", "multistability", {}),
    ("multistability", "multistability", {"omega": 0.6}),
    ("multistability", "multistability", {"format": "csv"}),
    ("multistability", "multistability", {"omega": 0.5, "format": "csv"}),
    ("soft", "diagram", {}),
    ("ball", "diagram", {}),
)
#: Answers that need no job.
MODEL: Final[tuple[tuple[str, dict[str, Any]], ...]] = (
    ("threshold", {"omega": 0.6, "xi": 0.05}),
    ("threshold", {"omega": 1.5, "xi": 0.3, "delta": 1e-3}),
    ("orbits", {"omega": 0.6, "xi": 0.05, "points": 20, "energy": True}),
    ("curves", {"xi": 0.05, "omega_start": 0.6, "omega_stop": 0.68, "gamma_max": 3.0, "modes": "1-1"}),
    ("curves", {"omega": 0.6, "xi_start": 0.02, "xi_stop": 0.1, "modes": "1-1", "kinds": "fold,flip"}),
)
#: Motions: of a cell, and from a drop and a state of contact.
MOTIONS: Final[tuple[dict[str, Any], ...]] = (
    {"gamma": 1.5, "omega": 0.5, "periods": 2, "samples": 10, "settle": 100},
    {"gamma": 2.3, "omega": 0.5, "periods": 2, "samples": 10, "start": {"kind": "drop", "phase": 1.0,
                                                                        "height": 2.0}},
    {"gamma": 0.7, "omega": 0.5, "periods": 1, "samples": 10, "settle": 0},
)  # fmt: skip
#: Requests whose memory is bounded before they are computed, each by what it asks for.
COSTLY: Final[tuple[tuple[str, str, dict[str, Any]], ...]] = (
    ("ramp", "diagram", {"omega": 0.7, "xi": 0.05}),
    ("ramp", "diagram", {"omega": 0.7, "xi": 0.05, "every": 4, "direction": "down", "format": "csv"}),
    ("ramp", "diagram", {"omega": 0.7, "xi": 0.05, "format": "svg"}),
    ("multistability", "multistability", {"omega": 0.5}),
    ("ramp", "threshold", {"xi": 0.05}),
    ("ramp", "modes", {"xi": 0.05}),
    ("ramp", "modes", {"xi": 0.05, "every": 2, "min_flight": 5.0}),
    ("ramp", "modes", {"xi": 0.05, "hysteresis": True}),
    ("ramp", "modes", {"xi": 0.05, "hysteresis": True, "direction": "up"}),
    ("ramp", "modes", {"xi": 0.05, "min_flight": 5.0}),
    ("rest", "diagram", {"start": 1.0, "stop": 2.0}),
    ("rest", "export", {"format": "parquet"}),
    ("rest", "export", {"format": "nc"}),
    ("rest", "zarr/outcome/c.0.0.0.0", {}),
    ("basins", "basins", {"gamma": 1.27}),
    ("multistability", "multistability", {}),
)
#: What the client makes of them.
READ: Final[tuple[tuple[str, str, dict[str, Any]], ...]] = (
    ("orbits", "open", {}),
    ("basins", "open", {}),
    ("multistability", "open", {}),
    ("adaptive", "open", {}),
)

_OF_THE_RUN: Final = ("job", "job_id", "release", "kernel_version")

#: Numbers of a list beyond this are told by their count, means and ends.
LONG: Final = 6
DIGITS: Final = 7


class Answers:
    """A service that computes here, a client of it, and the jobs that were asked for."""

    def __init__(self, service: TestClient) -> None:
        self._service = service
        self._client = Client("http://localhost", http=service)
        self._jobs: dict[str, str] = {}

    def told(self, case: str) -> Any:
        """What the answer of a case says, with long lists of numbers in short."""
        kind, number = case.split(maxsplit=1)[0], int(case.split()[1])
        if kind == "model":
            path, query = MODEL[number]
            return self._document(f"/v1/{path}", query)
        if kind == "motion":
            return _document(self._service.post("/v1/trajectories", json=_RIGID | MOTIONS[number]))
        if kind == "cost":
            spec = parse(list(SPECS.values())[number])
            study = study_of(spec)
            return study.estimate(spec, study.plan(spec)).model_dump(mode="json")  # not of a sample
        if kind == "query":
            name, document, query = QUERIES[number]
            return self._document(f"{self._job(name)}/{document}", query)
        if kind == "memory":
            name, document, query = COSTLY[number]
            return self._bytes_asked(f"{self._job(name)}/{document}", query)
        name, method, arguments = READ[number]
        job = self._client.job(self._job(name).rsplit("/", 1)[1])
        return _dataset(getattr(job, method)(**arguments).load())

    def _document(self, path: str, query: Mapping[str, Any]) -> Any:
        wait_for(lambda: self._service.get(path, params=query).status_code != 202)
        return _document(self._service.get(path, params=query))

    def _bytes_asked(self, path: str, query: Mapping[str, Any]) -> dict[str, int]:
        """The bytes that an answer waits for before it is computed, by its activity."""
        asked: dict[str, int] = {}
        acquire = Capacity.acquire

        async def noting(capacity: Capacity, activity: Activity, memory: int) -> Lease:
            asked[activity] = memory
            return await acquire(capacity, activity, memory)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Capacity, "acquire", noting)
            answer = self._service.get(path, params=query)
        assert answer.status_code == 200, answer.text
        return asked

    def _job(self, name: str) -> str:
        if name not in self._jobs:
            self._jobs[name] = finished(self._service, SPECS[name])
        return self._jobs[name]


def _dataset(data: xarray.Dataset) -> Any:
    attributes = {name: value for name, value in data.attrs.items() if name not in _OF_THE_RUN}
    variables = {
        name: [list(array.dims), str(array.dtype), _short(array.values.ravel().tolist()), _short(array.attrs)]
        for name, array in sorted(data.variables.items())
    }
    return {"attributes": _short(attributes), "variables": variables}


def _document(answer: Any) -> Any:
    assert answer.status_code == 200, answer.text
    content = answer.headers["Content-Type"].split(";")[0]
    if content == "application/json":
        document = answer.json()
        return _dataset(from_json(answer.content)) if "data_vars" in document else _short(document)
    if content == "text/csv":
        columns = zip_longest(*csv.reader(answer.text.splitlines()), fillvalue="")
        return {name: _short([_number(text) for text in column]) for name, *column in columns}
    raise AssertionError(f"an answer of type {content}")


def _number(text: str) -> Any:
    if not text:
        return None
    try:
        return float(text)
    except ValueError:
        return text


def _short(value: Any) -> Any:
    """The same with numbers rounded, and lists of many numbers by their count, means, and ends."""
    if isinstance(value, Mapping):
        return {name: _short(member) for name, member in value.items() if name not in ("id", "job", "links")}
    if isinstance(value, np.generic | np.ndarray):
        return _short(value.tolist())
    if isinstance(value, list | tuple):
        return _list(value)
    if isinstance(value, complex):
        return [_short(value.real), _short(value.imag)]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else str(value)
    return value


def _list(values: Sequence[Any]) -> Any:
    numbers = [np.nan if each is None else each for each in values]
    if len(values) <= LONG or not all(isinstance(each, bool | int | float) for each in numbers):
        return [_short(each) for each in values]
    array = np.array(numbers, float)
    finite = np.isfinite(array)
    here, order = array[finite], np.linspace(1.0, 2.0, len(array))[finite]
    means = [_short(float(np.mean(x))) if len(here) else None for x in (here, order * here)]
    ends = [_short(values[0]), _short(values[-1])]
    return {"numbers": len(array), "finite": len(here), "means": means, "ends": ends}


def _cases() -> Iterator[str]:
    kinds: dict[str, Iterable[Sequence[Any]]] = {
        "model": MODEL, "motion": [(motion,) for motion in MOTIONS], "cost": [(name,) for name in SPECS],
        "query": QUERIES, "memory": COSTLY, "client": READ,
    }  # fmt: skip
    for kind, rows in kinds.items():
        for number, parts in enumerate(rows):
            told = (_told(part) if isinstance(part, Mapping) else str(part) for part in parts)
            yield " ".join([kind, str(number), *told])


def _told(query: Mapping[str, Any]) -> str:
    return " ".join(f"{name}={value}" for name, value in query.items())


CASES: Final = tuple(_cases())


def _differences(found: Any, expected: Any, where: str = "") -> Iterator[str]:
    if isinstance(found, Mapping) and isinstance(expected, Mapping):
        for name in sorted({*found, *expected}):
            one, other = (each.get(name, "nothing") for each in (found, expected))
            yield from _differences(one, other, f"{where}.{name}")
    elif isinstance(found, list) and isinstance(expected, list) and len(found) == len(expected):
        for i, (one, other) in enumerate(zip(found, expected, strict=True)):
            yield from _differences(one, other, f"{where}[{i}]")
    elif isinstance(found, float) and isinstance(expected, float | int):
        if found != pytest.approx(expected, rel=1e-5, abs=1e-9):
            yield f"{where} is {found}, was {expected}"
    elif found != expected:
        yield f"{where} is {found}, was {expected}"


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Answers]:
    with computing(tmp_path_factory.mktemp("data")) as service:
        yield Answers(service)


@for_each("case", CASES)
def test_an_answer_says_what_it_did(answers: Answers, case: str):
    golden = json.loads(ANSWERS.read_text())["answers"]
    assert list(_differences(json.loads(json.dumps(answers.told(case))), golden[case])) == []


def write() -> None:
    """Write all answers as they are now."""
    with tempfile.TemporaryDirectory() as folder, computing(Path(folder)) as service:
        answers = Answers(service)
        told = {case: answers.told(case) for case in CASES}
    source = f"answers about small jobs, written by python {Path(__file__).relative_to(ROOT)}"
    lines = [f"  {json.dumps(case)}: {json.dumps(told[case], ensure_ascii=False)}" for case in CASES]
    start = f'{{\n "source": {json.dumps(source)},\n "answers": {{\n'
    ANSWERS.write_text(start + ",\n".join(lines) + "\n }\n}\n")


if __name__ == "__main__":
    write()
