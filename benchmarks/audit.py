"""Do audits hold the truth, what do they see, and does the choice of `auto` hold its bound?

    python -m benchmarks.audit coverage levels power damage auto efforts [--side 40] [--draws 1000]

Small sweeps are computed entirely in both ways: as a job does, and as an audit computes its cells again.
Their audits are then drawn `--draws` times from these cells. `coverage`: sweeps of four kinds as computed,
and with 0, .1, 1, 5 and 20 % of cells, thresholds and points made wrong at random; an interval holds if it
has the true share with the undecided cells counted as right and as wrong. `levels`: the same of the levels
that a budget computes of these sweeps, from coarse to fine, with their shares of cells and of the area that
are wrong. `power`: audits that see at least one of the faults planted in .5, 1, 2 and 5 % of the cells; -o
draws it. `damage`: what one audit says of three sweeps done badly. `auto`: ten sweeps with every contact; the
share of all cells beyond the tolerance against the bound that 120 random cells state, for each contact, and
how often it is chosen. `efforts`: random cells, or lines of a ramp, of the paper's figures and of a map by
each effort, against 3,000 plate periods of settling: the share with another outcome or mode, and
core-microseconds per cell.
"""

import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.measuring import describe, options, table
from kernel.params import Line, Outcome
from service.local import computed
from service.presets import FIGURES as PRESETS
from service.views import audit
from service.views.encode import picture
from service.views.selection import Stored
from worker.analysis.audit import PARTS, SETS, SIZES, look
from worker.analysis.model_selection import CELLS, ModelChoice, chosen, compared, timed
from worker.spec.time_steps import Cells
from worker.sweep import SweepSpec
from worker.sweep.levels import WHOLE, Steps, coarsest, finest, level
from worker.sweep.schema import MODE_ARRAYS
from worker.sweep.specification import EFFORTS

#: Shares of cells made wrong for `coverage`, and for `power`.
BANDS: Final = (0.0, 0.001, 0.01, 0.05, 0.2)
PLANTED: Final = (0.005, 0.01, 0.02, 0.05)
#: Cells of the samples of `power`.
SAMPLES: Final = (20, 59, 100, 200, 400, 800)
#: Twice the fewest points anywhere that are computed.
POINTS: Final = 400
#: The same where the share of the area is told level by level, and how many times finer a level is.
AREA: Final = 4_000
FINER: Final = 5
#: Questions whose intervals are asked for, by the set of cells that they draw.
ASKED: Final = {"mode": "numerics", "flights": "numerics", "threshold": "threshold", "area": "area"}

Census = dict[str, Any]  # what `look` returns of every cell, in arrays


def sweeps(side: int) -> dict[str, dict[str, Any]]:
    """A sweep of each kind, with about side x side cells."""
    rigid = {"kind": "rigid"}
    plane = {
        "gamma": {"start": 0.8, "stop": 5, "num": side},
        "omega": {"start": 0.3, "stop": 1.3, "num": side},
    }
    ramp = {"kind": "ramp", "axis": "gamma", "direction": "both"}
    lines = {"gamma": {"start": 0.6, "stop": 3, "num": 4 * side},
             "omega": {"start": 0.5, "stop": 1, "num": max(side // 8, 2)}}  # fmt: skip
    wide = {"gamma": {"start": 0.5, "stop": 8, "num": side}, "omega": {"start": 0.2, "stop": 3, "num": side}}
    return {
        "rest, rigid": plane | {"xi": 0.1, "model": rigid},
        "ramp, soft": lines | {"xi": 0.05, "protocol": ramp, "settle": 50, "observe": 50},
        "adaptive map": plane | {"xi": 0.26, "model": rigid, "refine": {"by": "mode", "coarsest": 8}},
        "coarse grid, ball": wide | {"xi": 0.2, "model": {"kind": "ball"}},
    }


def census(
    spec: SweepSpec, submitted: SweepSpec | None = None, points: int = POINTS
) -> tuple[Stored[SweepSpec], Census]:
    """A sweep computed, and every cell, threshold, and points anywhere, as an audit computes them again.

    submitted: the specification whose contact is asked for in `model`. points: twice the fewest.
    """
    study = Stored(spec, "", complete=True, submitted=submitted or spec)
    contact = None if submitted is None else submitted.model.exact
    cells = max(int(np.prod(spec.shape)), points)
    with tempfile.TemporaryDirectory() as folder, computed(spec, Path(folder), progress=False) as done:
        url = done.job.store_url
        with ThreadPoolExecutor(2) as threads:
            asked = (done.job.spec, url, contact, cells, 0, 0, audit.TOLERANCE)
            parts = list(threads.map(lambda part: look(*asked, part), range(PARTS)))
    return study, {**audit.table_of(parts), **{name: parts[0][name] for name in SIZES}}


def planted(all_cells: Census, share: float, random: np.random.Generator) -> Census:
    """The cells, all of them right but for a share of each set, whose bounces are wrong and flights off."""
    fields = ("outcome", "bounces", "periods", "label")
    made = all_cells | {name: all_cells[f"true_{name}"].copy() for name in fields}
    made["deviation"] = np.zeros(len(made["set"]))
    made["unknown"] = np.zeros(len(made["set"]), bool)
    for i, name in enumerate(SETS):
        units = np.unique(made["unit"][made["set"] == i])
        wrong = random.choice(units, round(share * len(units)), replace=False)
        cells = (made["set"] == i) & np.isin(made["unit"], wrong)
        made["bounces"][cells] += 1
        made["deviation"][cells] = 1.0
        if name == "threshold":
            resting = made["outcome"][cells] == Outcome.AT_REST
            made["outcome"][cells] = np.where(resting, Outcome.PERIODIC, Outcome.AT_REST)
    return made


def drawn(all_cells: Census, cells: int, random: np.random.Generator) -> Census:
    """An audit's cells: `cells` of the sweep, half as many points, a quarter as many thresholds."""
    keep = np.zeros(len(all_cells["set"]), bool)
    sizes = {"numerics": cells, "model": cells, "area": cells // 2, "threshold": cells // 4}
    for name, number in sizes.items():
        own = all_cells["set"] == SETS.index(name)
        units = np.unique(all_cells["unit"][own])
        keep |= own & np.isin(all_cells["unit"], random.choice(units, min(number, len(units)), replace=False))
    return {
        name: values[keep] if isinstance(values, np.ndarray) else values for name, values in all_cells.items()
    }


def answered(study: Stored[SweepSpec], cells: Census, against: str = "numerics") -> dict[str, Any]:
    """What an audit says of these cells, by question."""
    table = {name: values for name, values in cells.items() if isinstance(values, np.ndarray)}
    answers = audit.answers_of(study, audit.AuditQuery(), table, cells)
    return answers[against]


def coverage(side: int, draws: int, cells: int) -> str:
    """The share of audits whose interval holds the truth."""
    rows = []
    for kind, fields in sweeps(side).items():
        study, found = census(SweepSpec(**fields))
        random = np.random.default_rng(1)
        for share in (None, *BANDS):
            made = found if share is None else planted(found, share, random)
            truth = answered(study, made)
            name = f"{kind}, {'as computed' if share is None else f'{100 * share:g} %'}"
            rows.append([name, _share(truth["mode"]), *_held(study, made, draws, cells, random)])
            print(rows[-1], flush=True)
    return table(["sweep", "cells wrong", *ASKED], rows)


def budget_levels(side: int, draws: int, cells: int) -> str:
    """The share of each level that is wrong, and of audits whose interval holds it."""
    rows = []
    for kind, fields in sweeps(side).items():
        spec = SweepSpec(**fields)
        steps: Steps | None = coarsest(spec)
        while steps is not None:
            part = level(spec, steps)
            study, found = census(part, points=AREA)
            truth = answered(study, found)
            number = int(np.prod(part.shape))
            wrong = (_share(truth[name]) for name in ("mode", "area"))
            held = _held(study, found, draws, cells, np.random.default_rng(1))
            rows.append([f"{kind}, {number:,} cells", *wrong, *held])
            print(rows[-1], flush=True)
            steps = None if steps == WHOLE else finest(spec, FINER * number, within=steps) or WHOLE
    return table(["level", "cells wrong", "area wrong", *ASKED], rows)


def _held(
    study: Stored[SweepSpec], found: Census, draws: int, cells: int, random: np.random.Generator
) -> list[str]:
    """The share of audits whose interval holds the truth, by question."""
    truth = answered(study, found)
    rest = 1.0 - found["certified"] / found["cells"]
    held = dict.fromkeys(ASKED, 0)
    for _ in range(draws):
        said = answered(study, drawn(found, cells, random))
        for name in ASKED:
            weight = rest if ASKED[name] == "numerics" else 1.0
            held[name] += _holds(said[name], truth[name], weight)
    return [f"{100 * held[name] / draws:.1f} %" if truth[name].sampled else "-" for name in ASKED]


def _holds(said: Any, truth: Any, weight: float) -> bool:
    """Whether an interval holds the share, whatever the undecided cells are.

    weight: of what is drawn from in all cells.
    """
    if not truth.sampled:
        return True
    most = weight * (truth.changed + truth.undecided) / truth.sampled
    return bool(said.low <= truth.share + 1e-12 and most - 1e-12 <= said.high)


def _share(truth: Any) -> str:
    return f"{100 * truth.share:.2g} %"


def power(side: int, draws: int, output: str) -> str:
    """The share of audits that see a fault, by the cells drawn; `output`: its picture."""
    study, found = census(SweepSpec(**sweeps(side)["rest, rigid"]))
    random = np.random.default_rng(2)
    seen = np.zeros((len(PLANTED), len(SAMPLES)))
    for i, share in enumerate(PLANTED):
        made = planted(found, share, random)
        for k, cells in enumerate(SAMPLES):
            said = (answered(study, drawn(made, cells, random))["mode"] for _ in range(draws))
            seen[i, k] = np.mean([each.changed > 0 for each in said])
    if output:
        drawing = picture((6.0, 4.0), lambda figure: _draw_power(figure, seen), "png", {"release": "-"})
        Path(output).write_bytes(drawing)
    rows = [
        [f"{100 * share:g} %", *(f"{100 * x:.0f} %" for x in row)]
        for share, row in zip(PLANTED, seen, strict=True)
    ]
    return table(["cells wrong", *(f"{cells} drawn" for cells in SAMPLES)], rows)


def _draw_power(figure: Any, seen: NDArray[np.float64]) -> None:
    axes = figure.subplots()
    axes.set(xscale="log", xlabel="cells drawn", ylabel="share of audits that see a fault", ylim=(0, 1.02))
    for share, row in zip(PLANTED, seen, strict=True):
        axes.plot(SAMPLES, row, "o-", label=f"{100 * share:g} % of the cells wrong")
    axes.minorticks_off()
    axes.set_xticks(SAMPLES, [str(cells) for cells in SAMPLES])
    axes.legend(frameon=False)


def damage(side: int, cells: int) -> str:
    """What one audit says of a sweep that hardly settles, of a contact too soft, of a grid too coarse."""
    soft = {"kind": "soft", "penetration": 1e-3, "restitution": 0.01}
    plane = {name: sweeps(side)["rest, rigid"][name] for name in ("gamma", "omega", "xi")}
    coarse = {name: plane[name] | {"num": max(side // 5, 2)} for name in ("gamma", "omega")}
    auto = SweepSpec(**plane, model=soft | {"kind": "auto"})
    cases = {
        "settle 5": (SweepSpec(**plane, model=soft, settle=5), None, "mode"),
        "penetration 0.1": (SweepSpec(**plane, model=soft | {"penetration": 0.1}), auto, "mode"),
        "a grid five times as coarse": (SweepSpec(**plane | coarse, model=soft), None, "area"),
        "none": (SweepSpec(**plane, model=soft), None, "mode"),
    }
    rows = []
    for name, (spec, submitted, question) in cases.items():
        study, found = census(spec, submitted)
        against = "model" if submitted else "numerics"
        said = answered(study, drawn(found, cells, np.random.default_rng(3)), against)[question]
        rows.append([name, question, f"{said.changed} of {said.sampled}",
                     f"{100 * said.low:.2g} to {100 * said.high:.2g} %"])  # fmt: skip
    return table(["damage", "question", "changed", "share of all cells"], rows)


def choices() -> Iterator[SweepSpec]:
    """Ten sweeps with `auto`, over the plane, of hard and of soft contacts, within small and large errors."""
    gamma = {"start": 0.8, "stop": 5, "num": 40}
    omega = {"start": 0.3, "stop": 1.3, "num": 40}
    for xi, penetration in ((0.05, 1e-3), (0.26, 1e-3), (0.1, 1e-6), (0.5, 1e-4), (1.0, 1e-3)):
        for tolerance in (1e-3, 3e-2):
            model = {"kind": "auto", "penetration": penetration, "restitution": 0.01, "tolerance": tolerance}
            yield SweepSpec(gamma=gamma, omega=omega, xi=xi, model=model)


def auto(draws: int) -> str:
    """How often the share of all cells beyond the tolerance lies under the bound that a choice states."""
    rows = []
    for spec in choices():
        xi, omega, gamma = np.meshgrid(*(spec.axis_values(axis) for axis in spec.AXES), indexing="ij")
        everywhere = [Cells(gamma.ravel(), omega.ravel(), xi.ravel())]
        models, outcome = compared(spec, everywhere)
        truth = _shares(chosen(spec, models, outcome))
        kinds, held, random = dict.fromkeys(models, 0), dict.fromkeys(models, 0), np.random.default_rng(4)
        for _ in range(draws):
            cells = random.choice(outcome.size, CELLS, replace=False)
            sample = {kind: (cost, errors[cells]) for kind, (cost, errors) in models.items()}
            choice = chosen(spec, sample, outcome[cells])
            kinds[choice.model] += 1
            for row in choice.table:
                held[row.model] += truth[row.model] <= (row.most or 0.0)
        name = f"xi {spec.xi:g}, d {spec.model.exact.penetration:g}, within {spec.model.tolerance:g}"
        rows.append([name, *(f"{100 * truth[kind]:.2g} %, {100 * held[kind] / draws:.1f} %, {kinds[kind]}"
                             for kind in models)])  # fmt: skip
        print(rows[-1], flush=True)
    return table(["beyond the tolerance, bound held, chosen", *kinds], rows)


def _shares(choice: ModelChoice) -> dict[str, float]:
    """The share of the cells that are beyond the tolerance with each model."""
    return {row.model: row.beyond / row.drawn for row in choice.table}


#: Sweeps of the paper's figures by their number and place, of presets.
FIGURES: Final = ((2, 0), (2, 1), (3, 0), (4, 0), (6, 0), (7, 0), (8, 0), (9, 0))
#: Cells or lines of them that `efforts` computes.
EFFORT_CELLS, EFFORT_LINES = 400, 1


def efforts() -> str:
    """What each effort shows wrong, and costs."""
    plane = {"gamma": {"start": 0.1, "stop": 5, "num": 197}, "omega": {"start": 0.3, "stop": 1.7, "num": 141}}
    presets = {figure.number: figure.sweeps for figure in PRESETS}
    asked = {str(presets[number][i]["name"]): presets[number][i] for number, i in FIGURES}
    rows = []
    for name, fields in (asked | {"mode map": plane | {"xi": 0.05, "model": {"kind": "rigid"}}}).items():
        plain = {field: x for field, x in fields.items() if field not in ("settle", "observe", "exponents")}
        lines = _lines(SweepSpec(**plain))
        true, _ = timed(SweepSpec(**plain, settle=3_000, observe=1_000), lines)
        row = [name]
        for effort in EFFORTS:
            spec = SweepSpec(**plain, effort=effort)
            records, microseconds = timed(spec, lines)
            pairs = zip(records, true, strict=True)
            wrong = np.concatenate([_another(*pair)[pair[1].outcome != Outcome.SETTLING] for pair in pairs])
            row += [f"{100 * np.mean(wrong):.2g} %", f"{microseconds * sum(spec.window):,.0f}"]
        rows.append(row)
        print(row, flush=True)
    return table(["sweep", *(f"{name}{what}" for name in EFFORTS for what in ("", ", µs"))], rows)


def _lines(spec: SweepSpec) -> list[Cells]:
    """Random cells of a sweep from rest, or lines of a ramp in their order."""
    axis, random = spec.ramp_axis, np.random.default_rng(5)
    values = {name: spec.axis_values(name) for name in spec.AXES}
    if axis is None:
        chosen = {name: random.choice(along, EFFORT_CELLS) for name, along in values.items()}
        return [Cells(**chosen)]
    runs = {"up": values[axis], "down": values[axis][::-1]}
    along = np.concatenate([runs[direction] for direction in spec.directions])
    others = [
        {name: np.full(len(along), random.choice(each)) for name, each in values.items()}
        for _ in range(EFFORT_LINES)
    ]
    return [Cells(**other | {axis: along}) for other in others]


def _another(record: Line, true: Line) -> NDArray[np.bool_]:
    """Which cells have another outcome or mode."""
    return np.any([getattr(record, name) != getattr(true, name) for name in MODE_ARRAYS], axis=0)


def main() -> None:
    """Run what is asked for."""
    asked = options(
        __doc__,
        parts=["coverage", "levels", "power", "damage", "auto", "efforts"],
        side=40,
        draws=1_000,
        cells=200,
        output="",
    )
    print(describe())
    if "coverage" in asked.parts:
        print(coverage(asked.side, asked.draws, asked.cells))
    if "levels" in asked.parts:
        print(budget_levels(asked.side, asked.draws, asked.cells))
    if "power" in asked.parts:
        print(power(asked.side, asked.draws, asked.output))
    if "damage" in asked.parts:
        print(damage(asked.side, asked.cells))
    if "auto" in asked.parts:
        print(auto(asked.draws))
    if "efforts" in asked.parts:
        print(efforts())


if __name__ == "__main__":
    main()
