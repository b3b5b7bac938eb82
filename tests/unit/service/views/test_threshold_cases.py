"""Thresholds say what they know: sweeps, and the answer for each by the worker's rule; differences over HTTP.

A row gives the outcomes of the cells along gamma, 1.0 at the first, in steps of 0.1: r at rest, p periodic,
a aperiodic, s settling, u unresolved, d diverged, . missing. The outcomes are put into the store of a
finished job, so that every case takes the way from the store to the answer. What the kernel itself gives is
tested in tests/unit/worker/analysis/test_thresholds.py.
"""

from typing import Any, Final, NamedTuple

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

NOT_RAMPED: Final = (None, "not ramped")


class Case(NamedTuple):
    """Rows of outcomes per direction and Ω, and per Ω the answer: (value or None, status)."""

    name: str
    rows: dict[str, tuple[str, ...]]
    up: tuple[tuple[float | None, str], ...]
    down: tuple[tuple[float | None, str], ...] = (NOT_RAMPED,)
    xi: float = 0.26
    omega: tuple[float, ...] = (0.5,)
    gamma: tuple[float, float] = (1.0, 0.1)  # the lowest, and the step


def rest(name: str, row: str, value: float | None, status: str) -> Case:
    return Case(name, {"rest": (row,)}, ((value, status),))


def loop(
    name: str, rows: tuple[str, str], up: tuple[float | None, str], down: tuple[float | None, str]
) -> Case:
    return Case(name, {"up": (rows[0],), "down": (rows[1],)}, (up,), (down,))


CASES: Final = [
    rest("found", "rrrpp", 1.3, "found"),
    rest("found, aperiodic at once", "rraaa", 1.2, "found"),
    rest("the grid too high", "ppppp", None, "below the grid"),
    rest("the grid too low", "rrrrr", None, "above the grid"),
    rest("one gamma, which bounces", "p", None, "below the grid"),
    rest("one gamma, at rest", "r", None, "above the grid"),
    rest("bouncing with a gap of rest", "rrprp", 1.2, "found"),
    rest("settling at the edge", "rrspp", None, "settling"),
    rest("settling far above the edge", "rrpsp", 1.2, "found"),
    rest("settling at the lowest gamma", "srrpp", None, "settling"),
    rest("settling at the highest gamma alone", "rrrrs", None, "settling"),
    rest("unresolved at the edge", "rrupp", None, "unresolved"),
    rest("diverged at the edge", "rrdpp", None, "diverged"),
    rest("missing at the edge", "rr.pp", None, "missing"),
    rest("nothing computed", ".....", None, "missing"),
    Case("no gamma bounces: an undamped spring at sqrt(2)", {"rest": ("rrrrr",)}, ((None, "never bounces"),),
         xi=0.0, omega=(float(np.sqrt(2.0)),)),
    Case("a gap in omega", {"rest": ("rrppp", "rrrrr", "ppppp", "rrrpp")},
         ((1.2, "found"), (None, "above the grid"), (None, "below the grid"), (1.3, "found")),
         (NOT_RAMPED,) * 4, omega=(0.4, 0.5, 0.6, 0.7)),
    Case("a ramp up alone", {"up": ("rrrpp",)}, ((1.3, "found"),)),
    Case("a ramp down alone", {"down": ("rppaa",)}, (NOT_RAMPED,), ((1.1, "found"),)),
    Case("a ramp down that never bounces", {"down": ("rrrrr",)}, (NOT_RAMPED,), ((None, "never bounces"),)),
    loop("hysteresis", ("rrrpp", "rpppp"), (1.3, "found"), (1.1, "found")),
    loop("up found, down below the grid", ("rrrpp", "ppppp"), (1.3, "found"), (None, "below the grid")),
    loop("up found, settling where bouncing ends", ("rrrpp", "rrspp"), (1.3, "found"), (None, "settling")),
    loop("up found, down unresolved and not computed", ("rrrpp", "..upp"), (1.3, "found"), (None, "missing")),
]  # fmt: skip


def spec_of(case: Case) -> SweepSpec:
    cells, (lowest, step) = len(next(iter(case.rows.values()))[0]), case.gamma
    direction = "both" if len(case.rows) == 2 else next(iter(case.rows))
    protocol = {"kind": "rest"}
    if direction != "rest":
        protocol = {"kind": "ramp", "axis": "gamma", "direction": direction}
    return SweepSpec(
        name=case.name, gamma=[round(lowest + step * i, 2) for i in range(cells)], omega=list(case.omega),
        xi=case.xi, protocol=protocol, model={"kind": "rigid"}, settle=0, observe=20, keep=1,
    )  # fmt: skip


def outcomes_of(case: Case) -> dict[str, np.ndarray]:
    """By direction, (n_omega, n_gamma)."""
    return {
        direction: np.array([[OUTCOMES[letter] for letter in row] for row in rows], np.uint8)
        for direction, rows in case.rows.items()
    }


@for_each("case", CASES)
def test_the_worker_reads_the_grid(case: Case):
    spec = spec_of(case)
    gamma, endless = spec.axis_values("gamma"), endless_rest(spec, spec.axis_values("omega"), case.xi)
    for direction, rows in outcomes_of(case).items():
        down = direction == "down"
        for row, never, expected in zip(rows, endless, case.down if down else case.up, strict=True):
            found = on_grid(row, down, bool(never))
            value = gamma[found.bouncing] if found.status is Status.FOUND else None
            assert (value, found.status) == expected


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
    case = Case("", {"down": ("rrppp",)}, (), xi=xi, omega=(omega,), gamma=(down - 2 * step, step))
    found = get(client, f"{submitted(client, case)}/threshold")["data_vars"]
    assert found["down"]["data"] == [down]
    assert found["difference"]["data"][0][: len(why) or None] == why


@pytest.mark.parametrize(("model", "text"), [
    ({"kind": "rigid", "restitution": 0.1}, "rigid, restitution 0.1"),
    ({"kind": "soft", "rest_length": 9.0}, "soft, restitution 0.01, rest length 9, adhesive"),
])  # fmt: skip
def test_a_prediction_for_another_contact_names_both(model: dict[str, Any], text: str, client: TestClient):
    here = finished(client, spec_of(CASES[0]).as_submitted() | {"model": model})
    said = get(client, f"{here}/threshold")["attrs"]["prediction"]
    assert said == f"rigid, restitution 0: not the contact of the sweep, which is {text}"


def test_refining_more_than_one_answer_may_is_refused(client: TestClient, monkeypatch: pytest.MonkeyPatch):
    here = submitted(client, CASES[0])
    monkeypatch.setattr("service.views.threshold.MAX_SECONDS", 0.0)
    answer = client.get(f"{here}/threshold", params={"tolerance": 1e-3})
    assert answer.status_code == 422
    assert "tolerance: refining 1 values of omega" in answer.json()["detail"]


def submitted(client: TestClient, case: Case) -> str:
    """The path of a finished job whose store holds the outcomes of the case."""
    spec = spec_of(case)
    here = finished(client, spec.as_submitted())
    settings: Settings = client.app.state.service.settings  # type: ignore[attr-defined]
    url = str(store_in(settings.data, here.rsplit("/", 1)[-1]))
    length, outcomes = schema.sizes(spec), outcomes_of(case)
    for chunk in make_plan(spec):
        cells = dict(zip(CELL_DIMS, chunk.slices, strict=True))
        record: dict[str, Any] = {
            array.name: np.zeros((*chunk.shape, *(length[dim] for dim in array.extra_dims)), array.dtype)
            for array in schema.arrays(spec)
        }
        plane = outcomes[spec.directions[chunk.direction]]
        record["outcome"] = plane[cells["omega"], cells["gamma"]][None]
        store.write_chunk(url, chunk, record)
    return here
