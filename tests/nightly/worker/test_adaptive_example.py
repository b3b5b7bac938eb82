"""The adaptive map of docs/specification.md against every cell of its grid."""

import json
import re
import time
from pathlib import Path

import numpy as np
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
