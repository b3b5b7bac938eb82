"""A new result in one module: how many cells of each outcome there are along gamma."""

from typing import Any

import numpy as np
import pytest
import xarray

from kernel.params import Line, Outcome
from service.views.selection import Stored, nearest_index, read_stored
from service.views.variables import coordinate, dataset, variable
from service.views.view import Estimate, Number, Query, View
from worker.study import Array
from worker.study.layout import CELL_DIMS
from worker.sweep import SweepSpec, schema

COUNT = Array("count", (*CELL_DIMS, "kind"), "<i8", 0, {"long_name": "cells with this outcome", "units": "1"})


class OutcomesQuery(Query):
    """The plane at the nearest value of xi."""

    xi: Number | None = None


def compute(study: Stored[SweepSpec], query: OutcomesQuery) -> xarray.Dataset:
    """Cells of each outcome at every gamma, over all omega."""
    spec, xi = study.spec, nearest_index(study.spec, "xi", query.xi)
    outcome = read_stored(study, ["outcome"], {"direction": 0, "xi": xi.index})["outcome"]
    counts = np.stack([(outcome == kind).sum(axis=0) for kind in Outcome], axis=1)
    coords = {
        "gamma": coordinate("gamma", spec.axis_values("gamma")), "xi": coordinate("xi", xi.value),
        "kind": coordinate("kind", [kind.name.lower() for kind in Outcome]),
    }  # fmt: skip
    complete = study.is_complete(outcome)
    return dataset({"count": variable(("gamma",), counts, COUNT)}, coords, {"complete": complete})


def estimate(spec: SweepSpec, query: OutcomesQuery) -> Estimate:
    """All gamma and outcomes."""
    return Estimate({"gamma": len(spec.axis_values("gamma")), "kind": len(Outcome)}, reads=("omega", "gamma"))


VIEW = View(
    "outcomes", "Outcomes along gamma", SweepSpec, OutcomesQuery, compute, estimate,
    variables=(COUNT,), rows="count",
)  # fmt: skip


def add_stored_variable(patch: pytest.MonkeyPatch) -> Array:
    """A variable added to the schema and to the kernel's record: `contacts`, one more than the flights."""
    added = Array("contacts", CELL_DIMS, "<i4", 0, {"long_name": "contacts of the window", "units": "1"})
    stored: Any = schema.arrays
    patch.setattr(schema, "arrays", lambda spec: (added, *stored(spec)))
    patch.setattr(Line, "contacts", property(lambda line: line.flights + 1), raising=False)
    return added
