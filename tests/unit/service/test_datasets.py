"""Answers as Datasets: what is missing, unfinished or empty, on answers made for it."""

from typing import Any

import pytest

from service.client import UnexpectedAnswer
from service.client.datasets import multistability_dataset

JOB = "0" * 32


def place(id: int, fraction: float, **more: Any) -> dict[str, Any]:
    return {"id": id, "label": f"({id},1)", "fraction": fraction, "longest_flight": 5.0, **more}


PLANE: dict[str, Any] = {
    "omega": [0.5], "gamma": [1.0, 1.2, 1.4], "xi": 0.26, "count": [[2, 1, None]],
    "cells": [[[place(1, 0.75), place(2, 0.25)], [place(1, 1.0)], []]],
    "attractors": [{"id": 1, "label": "(1,1)", "cells": 2}, {"id": 2, "label": "(2,1)", "cells": 1}],
    "events": [
        {"kind": "death", "attractor": 2, "omega": 0.5, "gamma_below": 1.0, "gamma_above": 1.2,
         "below": "(2,1)", "above": None, "leads_to": None},
    ],
    "several": 0.5, "several_by_drops": None, "complete": False,
}  # fmt: skip


def test_a_short_answer_that_asks_for_much_memory_is_refused():
    cells = [[[place(1, 1.0)] * 11_000] + [[]] * 11_000]
    with pytest.raises(UnexpectedAnswer, match="values; at most 100,000,000 are read"):
        multistability_dataset(PLANE | {"cells": cells}, JOB)
