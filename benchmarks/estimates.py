"""What is expected of a study beside what it takes: twenty specifications.

    python -m benchmarks.estimates [--repeat 1] [--only ramp]
    python -m benchmarks.estimates --left [--only ramp]

Every chunk is computed in this process, its kernels compiled before. Prints core-seconds expected by a
sample of the study (`bounce run`, `bounce plan` and the form show them divided by the workers), the processor
time, and their ratio: above 1, less was expected than it took. `--table`: by the table of contact models,
as where the kernel is not compiled yet. `--only`: names that contain this.

`--left`: finer grids of the same through a service with two workers, its kernels compiled. Prints the least
and the largest ratio of the time left that jobs said to what remained, after a tenth of their time.
"""

import tempfile
import time
from typing import Any, Final

from benchmarks.measuring import describe, options, service, short, table
from service.client import Client
from worker import store
from worker.kernel_cache import use_cache
from worker.pace import pace
from worker.spec.axes import MAX_AXIS_VALUES
from worker.studies import parse, run_task, study_of
from worker.work import compile_for

_PLANE: Final = {
    "gamma": {"start": 0.5, "stop": 6.0, "num": 160},
    "omega": {"start": 0.3, "stop": 1.5, "num": 40},
    "xi": 0.1,
}
_LINE: Final = {"gamma": {"start": 0.5, "stop": 6.0, "num": 800}, "omega": 0.5, "xi": 0.26}
_UP_AND_DOWN: Final = {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}}


def _rigid(restitution: float = 0.0) -> dict[str, Any]:
    return {"model": {"kind": "rigid", "restitution": restitution}}


def _soft(**fields: Any) -> dict[str, Any]:
    return {"model": {"kind": "soft", **fields}}


SPECS: Final[dict[str, dict[str, Any]]] = {
    "rest, rigid": _PLANE | _rigid(),
    "rest, rigid, fixed windows": _PLANE | _rigid() | {"settle": 200},
    "rest, rigid, low damping": _PLANE | _rigid() | {"xi": 0.02},
    "rest, rigid, e = 0.3": _PLANE | _rigid(0.3),
    "rest, rigid, e = 0.8": _PLANE | _rigid(0.8),
    "rest, rigid, e = 0.99": _PLANE | _rigid(0.99),
    "rest, soft": _PLANE | _soft(),
    "rest, soft, d = 1e-5": _PLANE | _soft(penetration=1e-5),
    "rest, soft, nonadhesive": _PLANE | _soft(adhesive=False),
    "rest, soft, e = 0.5": _PLANE | _soft(restitution=0.5),
    "rest, ball": _PLANE | {"model": {"kind": "ball", "restitution": 0.3}},
    "rest, slow plate": _PLANE | _rigid() | {"omega": {"start": 0.02, "stop": 0.1, "num": 40}},
    "rest, exponents": _LINE | _rigid() | {"exponents": 1},
    "ramp, rigid": _PLANE | _rigid() | _UP_AND_DOWN,
    "ramp, soft": _PLANE | _soft() | _UP_AND_DOWN,
    "ramp, soft, one line": _LINE | _soft() | _UP_AND_DOWN,
    "ramp, ball, e = 0.7": _PLANE | {"model": {"kind": "ball", "restitution": 0.7}} | _UP_AND_DOWN,
    "map, rigid": _PLANE | _rigid() | {"refine": {"by": "mode"}},
    "basin, rigid": {
        "gamma": [2.0, 3.6], "omega": 0.5, "xi": 0.26,
        "protocol": {"kind": "basin", "rows": 64, "columns": 96},
    } | _rigid(),
    "multistability, rigid": {
        "gamma": {"start": 3.0, "stop": 4.0, "num": 40}, "omega": [0.4, 0.5], "xi": 0.26,
        "protocol": {"kind": "multistability"},
    } | _rigid(),
}  # fmt: skip


def measured(spec: Any, *, by_table: bool = False) -> tuple[float, float]:
    """Core-seconds expected of a study, and its processor time."""
    study = study_of(spec)
    plan = study.plan(spec)
    compile_for(spec)
    expected = study.estimate(spec, plan).at(None if by_table else pace(spec)).core_seconds
    with tempfile.TemporaryDirectory() as folder:
        url = f"{folder}/store.zarr"
        store.create(url, study.variables(spec, plan.chunk_shape))
        before = time.process_time()
        for index in range(len(plan)):
            run_task(spec, plan[index], url)
        return expected, time.process_time() - before


#: Jobs whose time left is compared take about this long, s, with two workers.
LASTS: Final = 20.0


def finer(fields: dict[str, Any], expected: float) -> dict[str, Any]:
    """A study with enough values of gamma for two workers to take LASTS, or all that are allowed."""
    gamma = fields["gamma"]
    num = min(round(gamma["num"] * 2.0 * LASTS / expected), MAX_AXIS_VALUES)
    return {**fields, "gamma": {**gamma, "num": num}}


def time_left(client: Client, spec: dict[str, Any]) -> tuple[float, list[float]]:
    """The time of a job, s, and the ratios of the time left that it said to what remained, each second."""
    said, began = [], time.monotonic()
    job = client.submit(spec)
    while job.refresh().state in ("queued", "running"):
        left = job.progress.eta_seconds
        if left is not None:
            said.append((time.monotonic(), left))
        time.sleep(0.5)
    ended = time.monotonic()
    took = ended - began
    return took, [left / (ended - at) for at, left in said if at - began > 0.1 * took and ended - at > 1.0]


def compare_left(only: str) -> None:
    """Print the table of `--left`."""
    rows = []
    with service() as (client, _, _):
        for name, fields in SPECS.items():
            if only in name and not isinstance(fields["gamma"], list):
                client.submit(finer(fields, 1e3)).wait(progress=False)  # compiles
                took, ratios = time_left(client, finer(fields, client.estimate(fields).core_seconds))
                ends = (min(ratios), max(ratios)) if ratios else (float("nan"),) * 2  # too few chunks
                rows.append((name, *map(short, (took, *ends))))
                print(*rows[-1], sep=", ", flush=True)
    print(table(("study", "took, s", "least", "largest"), rows))


def main() -> None:
    """Measure and print the table."""
    arguments = options(__doc__, repeat=1, only="", table=False, left=False)
    print(describe("numba"), flush=True)
    if arguments.left:
        compare_left(arguments.only)
        return
    use_cache()
    rows, ratios = [], []
    for name, fields in SPECS.items():
        if arguments.only in name:
            results = [
                measured(parse(fields), by_table=arguments.table) for _ in range(arguments.repeat + 1)
            ][1:]
            expected, took = min(results, key=lambda each: each[1])
            ratios.append(took / expected)
            rows.append((name, short(expected), short(took), f"{took / expected:.2f}"))
            print(*rows[-1], sep=", ", flush=True)
    print(table(("study", "expected, s", "took, s", "ratio"), rows))
    within = sum(1 / 1.5 <= ratio <= 1.5 for ratio in ratios)
    print(f"{within} of {len(ratios)} within a factor of 1.5")


if __name__ == "__main__":
    main()
