"""Adaptive maps, that of docs/specification.md and small ones, against every cell of their grids."""

import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import ROOT

from kernel.params import Outcome
from worker import store
from worker.kernel_cache import use_cache
from worker.studies import run_task, study_of
from worker.sweep import SweepSpec
from worker.sweep.schema import MODE_ARRAYS, layout
from worker.work import compile_for

EXAMPLE = re.compile(r"<!-- file: map.json -->\n```json\n(.*?)```", re.DOTALL)


def computed(spec: SweepSpec, url: Path) -> tuple[dict[str, np.ndarray], float]:
    """The plane of a map, and the core-seconds that it takes, storing included."""
    plan = study_of(spec).plan(spec)
    store.create(str(url), layout(spec, plan.chunk_shape))
    compile_for(spec)
    began = time.process_time()
    for chunk in plan:
        run_task(spec, chunk, str(url))
    took = time.process_time() - began
    stored = store.read_slice(str(url), MODE_ARRAYS, complete=True)
    return {name: array[0, 0] for name, array in stored.items()}, took


def test_the_example_has_the_shares_of_the_whole_grid_in_half_of_its_time(tmp_path: Path):
    use_cache()
    [text] = EXAMPLE.findall((ROOT / "docs" / "specification.md").read_text())
    fields = json.loads(text)
    found, seconds = computed(SweepSpec.parse(fields), tmp_path / "map.zarr")
    whole = SweepSpec.parse(fields | {"refine": None})
    full, full_seconds = computed(whole, tmp_path / "full.zarr")
    for outcome in Outcome:
        shares = [float(np.mean(cells["outcome"] == outcome)) for cells in (found, full)]
        assert abs(shares[0] - shares[1]) < 0.01, f"{outcome.name}: {shares}"
    wrong = np.any([found[name] != full[name] for name in MODE_ARRAYS], axis=0)
    assert np.mean(wrong) < 0.01
    assert seconds < 0.5 * full_seconds


@pytest.mark.parametrize(
    ("model", "xi", "outcome", "mode"),
    [
        ({"kind": "rigid"}, 0.03, 0.007, 0.007),
        ({"kind": "rigid", "restitution": 0.5}, 0.03, 0.007, 0.007),
        ({"kind": "soft", "restitution": 0.5, "penetration": 0.01}, 0.03, 0.007, 0.007),
        ({"kind": "soft"}, 0.4, 0.007, 0.007),
        ({"kind": "ball", "restitution": 0.45}, 0.26, 0.12, 0.53),
        ({"kind": "ball", "restitution": 0.6}, 0.26, 0.12, 0.53),
    ],
    ids=str,
)
def test_small_maps_miss_more_of_a_ball_than_of_a_spring(
    model: dict[str, Any], xi: float, outcome: float, mode: float, tmp_path: Path
):
    use_cache()
    gamma, omega = {"start": 0.5, "stop": 6.0, "num": 89}, {"start": 0.3, "stop": 1.7, "num": 89}
    fields = {"gamma": gamma, "omega": omega, "xi": xi, "model": model, "keep": 8}
    found, _ = computed(SweepSpec.parse(fields | {"refine": {"by": "mode"}}), tmp_path / "map.zarr")
    full, _ = computed(SweepSpec.parse(fields), tmp_path / "full.zarr")
    wrong = np.any([found[name] != full[name] for name in MODE_ARRAYS], axis=0)
    assert np.mean(found["outcome"] != full["outcome"]) < outcome
    assert np.mean(wrong) < mode
