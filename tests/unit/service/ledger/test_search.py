"""Jobs found in the ledger and over HTTP: every condition, every order, page by page."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import Held, sweep
from served import service
from tables import for_each

from service.errors import InvalidRequest
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState, NewJob
from service.ledger.search import JobOrder, JobSearch

SWEEP: dict[str, Any] = sweep().as_submitted()

NAMES = ("Figure 2", "figure 10", "100 %", "a_b", "axb", "", "Ω-sweep", "back\\slash")
MODELS = ("rigid", "soft")
PROTOCOLS = ("rest", "ramp")
STATES = (JobState.QUEUED, JobState.RUNNING, JobState.DONE, JobState.FAILED)


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ledger]:
    """Forty jobs of all names, models, protocols and states, a day apart."""
    with Ledger(tmp_path_factory.mktemp("data") / "ledger.sqlite") as ledger:
        with ledger.writing() as writing:
            for number in range(40):
                _accept(writing, number)
        yield ledger


def _accept(writing: Any, number: int) -> None:
    model, protocol = MODELS[number % 2], PROTOCOLS[number // 2 % 2]
    spec = f'{{"model": {{"kind": "{model}"}}, "protocol": {{"kind": "{protocol}"}}}}'
    job_id = f"{number * 0x1F35:032x}"[::-1]
    new = NewJob(job_id, NAMES[number % 8], spec, "3", (1, 1, 1), 1, 100 * (number % 7))
    writing.insert(new, 86_400.0 * number)
    state = STATES[number // 4 % 4]
    if state is not JobState.QUEUED:
        writing.run(writing.find(job_id), 86_400.0 * number + 1)
    if state in (JobState.DONE, JobState.FAILED):
        writing.finish(writing.find(job_id), state, 86_400.0 * number + 2 + number % 3 * 1e6)
    if number % 5 == 0:
        writing.update(writing.find(job_id), pinned=True)


def _allows(search: JobSearch, job: JobRecord) -> bool:
    """The slow twin of the SQL."""
    text = (search.search or "").casefold()
    return all(
        [
            text in job.name.casefold() or job.id.startswith(text),
            search.state in (None, job.state),
            search.model is None or f'"{search.model}"' in job.spec,
            search.protocol is None or f'"{search.protocol}"' in job.spec,
            search.pinned in (None, job.pinned),
            search.created_from is None or job.created >= search.created_from.timestamp(),
            search.created_before is None or job.created < search.created_before.timestamp(),
        ]
    )


def _sorted(jobs: list[JobRecord], order: JobOrder) -> list[JobRecord]:
    keys: dict[JobOrder, Any] = {
        JobOrder.NEWEST: lambda job: -job.seq,
        JobOrder.OLDEST: lambda job: job.seq,
        JobOrder.FINISHED: lambda job: (-(job.finished or 0), -job.seq),
        JobOrder.NAME: lambda job: ("".join(c.casefold() if c.isascii() else c for c in job.name), job.seq),
        JobOrder.LARGEST: lambda job: (-job.cells_total, -job.seq),
    }
    return sorted(jobs, key=keys[order])


def _maybe(*values: Any) -> st.SearchStrategy[Any]:
    return st.sampled_from([None, None, *values])


SEARCHES = st.builds(
    JobSearch,
    search=_maybe("FIG", "0 %", "a_b", "_", "%", "\\", "ω", "0"),
    state=_maybe(*STATES),
    model=_maybe(*MODELS, "ball"),
    protocol=_maybe(*PROTOCOLS),
    pinned=_maybe(True, False),
    created_from=_maybe(datetime(1970, 1, 1, tzinfo=UTC), datetime(1970, 1, 8)),
    created_before=_maybe(datetime(1970, 1, 31)),
    order=st.sampled_from(list(JobOrder)),
)


@given(search=SEARCHES, size=st.integers(1, 50))
@settings(max_examples=150, deadline=None)
def test_pages_hold_what_the_search_allows_in_its_order(ledger: Ledger, search: JobSearch, size: int):
    found: list[JobRecord] = []
    after = None
    with ledger.reading() as reading:
        expected = _sorted([job for job in reading.search() if _allows(search, job)], search.order)
        assert reading.count_found(search) == len(expected)
        while page := reading.search(search, size, after):
            found += page
            after = search.read_cursor(search.cursor_after(page[-1]))
    assert [job.seq for job in found] == [job.seq for job in expected]


#: The last one names half of a surrogate pair, which is no text.
WRONG_CURSORS = (
    *("", "x", "9" * 19, "٣", "W10", "W1tb" * 400),
    *("WyJuYW1lIiwgMSwgMV0", "WyJuYW1lIiwgIlx1ZDgwMCIsIDFd"),
)


@for_each("cursor", WRONG_CURSORS)
@for_each("order", list(JobOrder))
def test_a_cursor_of_another_list_is_refused(order: JobOrder, cursor: str):
    with pytest.raises(InvalidRequest):
        JobSearch(order=order).read_cursor(cursor)


def test_jobs_are_found_and_pinned_over_http(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        small, other = (
            client.post("/v1/jobs", json={**SWEEP, "name": name, "xi": xi}).json()
            for name, xi in (("Small", 0.1), ("other", 0.2))
        )

        def found(**query: Any) -> list[str]:
            answer = client.get("/v1/jobs", params=query).raise_for_status().json()
            assert answer["total"] == len(answer["jobs"])
            return [job["name"] for job in answer["jobs"]]

        etag = client.get(small["links"]["self"]).headers["ETag"]
        for _ in range(2):  # pinning twice is harmless
            pinned = client.post(small["links"]["pin"])
            assert (pinned.status_code, pinned.json()["pinned"]) == (200, True)
        assert client.get(small["links"]["self"]).headers["ETag"] != etag
        assert found(pinned=True) == ["Small"]
        etag = client.get(small["links"]["self"]).headers["ETag"]
        renamed = client.post(small["links"]["rename"], json={"name": "small"})
        assert (renamed.json()["name"], renamed.json()["spec"]["name"]) == ("small", "small")
        assert client.get(small["links"]["self"]).headers["ETag"] != etag
        assert client.post("/v1/jobs", json=small["spec"]).json()["id"] == small["id"]
        refused = client.post(small["links"]["rename"], json={"name": "x\n"})
        assert (refused.status_code, refused.json()["detail"]) == (
            422,
            "name: must be one line of printable characters",
        )
        client.post(small["links"]["rename"], json={"name": "Small"})
        assert found(pinned=False, order="oldest") == ["other"]
        assert found(search="SMALL") == found(search=small["id"][:9]) == ["Small"]
        assert found(search="\0") == found(search="%") == []
        assert found(model="rigid") == found(protocol="ramp") == []
        assert found(order="name", model="soft") == ["other", "Small"]
        day = small["created"][:10]
        assert found(created_from=day) == ["other", "Small"]
        assert found(created_before=day) == found(created_from="2999-01-01") == []
        second, east = timedelta(seconds=1), timezone(timedelta(hours=9))
        early, late = (datetime.fromisoformat(job["created"]).astimezone(east) for job in (small, other))
        assert found(created_from=(early - second).isoformat()) == ["other", "Small"]
        assert found(created_from=(late + second).isoformat()) == []
        assert found(created_before=(late + second).isoformat()) == ["other", "Small"]
        page = client.get("/v1/jobs", params={"order": "name", "limit": 1}).json()
        assert (page["total"], page["jobs"][0]["id"]) == (2, other["id"])
        rest = client.get("/v1/jobs", params={"order": "name", "limit": 1, "cursor": page["next"]}).json()
        assert (rest["next"], rest["jobs"][0]["id"]) == (None, small["id"])
        unpinned = client.post(small["links"]["unpin"])
        assert (unpinned.status_code, unpinned.json()["pinned"]) == (200, False)
        assert found(pinned=True) == []


WRONG = {
    "a cursor of another order": ({"order": "name", "cursor": "5"}, "cursor: must be `next` of the page"),
    "no such model": ({"model": "steel"}, "model: must be 'soft', 'stepped', 'rigid', 'ball' or 'auto'"),
    "no such protocol": ({"protocol": "fall"}, "protocol: must be 'rest', 'ramp', 'orbits', 'basin' or"),
    "no such order": ({"order": "best"}, "order: must be 'newest'"),
    "no such day": ({"created_from": "2026-02-30"}, "created_from: must be a day such as 2026-11-25, not "),
    "seconds": ({"created_from": "-1"}, "created_from: must be a day such as 2026-11-25, not -1"),
    "text without end": ({"search": "x" * 201}, "search: must have at most 200 characters, not 201"),
}


def test_wrong_searches_say_what_is_wrong(tmp_path: Path):
    with service(tmp_path, Held()) as client:
        for case, (query, rule) in WRONG.items():
            answer = client.get("/v1/jobs", params=query)
            assert answer.status_code == 422, case
            assert rule in answer.json()["detail"], case
