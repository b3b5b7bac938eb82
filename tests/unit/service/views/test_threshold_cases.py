"""Thresholds say what they know: rows of cells, the worker's answer for each, and differences over HTTP.

A row gives the outcomes of the cells along gamma: r at rest, p periodic, a aperiodic, s settling,
u unresolved, d diverged, . missing. What the kernel itself gives is tested in
tests/unit/worker/analysis/test_bisection.py.
"""

from typing import Any, Final

import numpy as np
import pytest
from fastapi.testclient import TestClient
from served import finished, get
from stores import store_in
from tables import for_each

from kernel.params import Outcome
from service.settings import Settings
from worker import store
from worker.analysis.bisection import Status, endless_rest, on_grid
from worker.study.layout import CELL_DIMS
from worker.sweep import SweepSpec, schema
from worker.sweep.plan import make_plan

OUTCOMES: Final = {
    "r": Outcome.AT_REST, "p": Outcome.PERIODIC, "a": Outcome.APERIODIC, "s": Outcome.SETTLING,
    "u": Outcome.UNRESOLVED, "d": Outcome.DIVERGED, ".": Outcome.MISSING,
}  # fmt: skip


def outcomes_of(row: str) -> np.ndarray:
    return np.array([OUTCOMES[letter] for letter in row], np.uint8)


def spec_of(
    row: str, direction: str = "rest", omega: float = 0.5, xi: float = 0.26, lowest: float = 1.0,
    step: float = 0.1,
) -> SweepSpec:  # fmt: skip
    """A sweep that could have the row."""
    ramp = {"kind": "ramp", "axis": "gamma", "direction": direction}
    return SweepSpec(
        gamma=[round(lowest + step * i, 2) for i in range(len(row))], omega=omega, xi=xi,
        protocol={"kind": "rest"} if direction == "rest" else ramp, model={"kind": "rigid"}, settle=0,
        observe=20, keep=1,
    )  # fmt: skip


#: Of rest or a ramp up: the row, the lowest cell that bounces for certain, if there is one, and the answer.
UP: Final = [
    ("rrrpp", 3, "found"),
    ("rraaa", 2, "found"),  # aperiodic at once
    ("rrprp", 2, "found"),  # bouncing with a gap of rest
    ("rrpsp", 2, "found"),  # settling far above the edge
    ("ppppp", None, "below the grid"),
    ("p", None, "below the grid"),
    ("rrrrr", None, "above the grid"),
    ("r", None, "above the grid"),
    ("rrspp", None, "settling"),
    ("srrpp", None, "settling"),
    ("rrrrs", None, "settling"),
    ("rrupp", None, "unresolved"),
    ("rrdpp", None, "diverged"),
    ("rr.pp", None, "missing"),
    (".....", None, "missing"),
]

DOWN: Final = [
    ("rppaa", 1, "found"),
    ("rpppp", 1, "found"),
    ("rrrrr", None, "never bounces"),
    ("ppppp", None, "below the grid"),
    ("rrspp", None, "settling"),
    ("..upp", None, "missing"),
]


@for_each(("down", "row", "bouncing", "status"), [(way is DOWN, *row) for way in (UP, DOWN) for row in way])
def test_the_worker_reads_a_row(down: bool, row: str, bouncing: int | None, status: str):
    found = on_grid(outcomes_of(row), down, endless=False)
    assert found.status == status
    assert bouncing is None or found.bouncing == bouncing


def test_an_undamped_spring_that_hardly_loads_the_plate_never_bounces():
    """At omega = sqrt(2)."""
    spec = spec_of("rrrrr", xi=0.0)
    endless = endless_rest(spec, np.sqrt([2.0, 3.0]), 0.0)
    assert endless.tolist() == [True, False]
    assert on_grid(outcomes_of("rrrrr"), down=False, endless=True).status is Status.NEVER


#: Of folds at Γ = 0.553245, and of Eq. 25 at 0.869608.
DIFFERENCES: Final = [
    (0.6, 0.05, 0.56, 0.01, ""),
    (0.6, 0.05, 0.55, 0.01, "bouncing lives about 61 plate periods 0.00324 below the fold, longer than the"),
    (0.6, 0.05, 0.45, 0.01, "another cycle lives 0.103 below the prediction"),
    (0.6, 0.05, 0.58, 0.02, "the ramp lost the cycle 0.0268 above the fold: its steps of 0.02 excite the"),
    (0.6, 0.05, 0.79, 0.07, "the ramp ends on another cycle, which shrinks to rest, 0.237 above the fold:"),
    (0.5, 0.26, 1.1, 0.1, "bouncing stops 0.23 above where rest ends: it still settles, or its window is"),
]


@for_each(("omega", "xi", "down", "step", "why"), DIFFERENCES)
def test_the_answer_says_why_a_threshold_is_not_the_predicted_one(
    omega: float, xi: float, down: float, step: float, why: str, client: TestClient
):
    spec = spec_of("rrppp", "down", omega, xi, down - 2 * step, step)
    found = get(client, f"{submitted(client, spec, 'rrppp')}/threshold")["data_vars"]
    assert found["down"]["data"] == [down]
    assert found["difference"]["data"][0][: len(why) or None] == why


@pytest.mark.parametrize(("model", "text"), [
    ({"kind": "rigid", "restitution": 0.1}, "rigid, restitution 0.1"),
    ({"kind": "soft", "rest_length": 9.0}, "soft, restitution 0.01, rest length 9, adhesive"),
])  # fmt: skip
def test_a_prediction_for_another_contact_names_both(model: dict[str, Any], text: str, client: TestClient):
    here = finished(client, spec_of("rrrpp").as_submitted() | {"model": model})
    said = get(client, f"{here}/threshold")["attrs"]["prediction"]
    assert said == f"rigid, restitution 0: not the contact of the sweep, which is {text}"


def test_refining_more_than_one_answer_may_is_refused(client: TestClient, monkeypatch: pytest.MonkeyPatch):
    here = submitted(client, spec_of("rrrpp"), "rrrpp")
    monkeypatch.setattr("service.views.threshold.MAX_SECONDS", 0.0)
    answer = client.get(f"{here}/threshold", params={"tolerance": 1e-3})
    assert answer.status_code == 422
    assert "tolerance: refining 1 values of omega" in answer.json()["detail"]


def submitted(client: TestClient, spec: SweepSpec, row: str) -> str:
    """The path of a finished job whose store holds the row."""
    here = finished(client, spec.as_submitted())
    settings: Settings = client.app.state.service.settings  # type: ignore[attr-defined]
    url = str(store_in(settings.data, here.rsplit("/", 1)[-1]))
    length = schema.sizes(spec)
    for chunk in make_plan(spec):
        cells = dict(zip(CELL_DIMS, chunk.slices, strict=True))
        record: dict[str, Any] = {
            array.name: np.zeros((*chunk.shape, *(length[dim] for dim in array.extra_dims)), array.dtype)
            for array in schema.arrays(spec)
        }
        record["outcome"] = outcomes_of(row)[None, None, cells["gamma"]]
        store.write_chunk(url, chunk, record)
    return here
