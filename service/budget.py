"""A sweep within a time: complete levels from coarse to fine; the last one is the answer.

The first levels are small and measure the speed, and the next fills the time. A level begins only if it fits
into the rest of the time, and is cancelled when the time is over. The time includes compiling, waiting for
workers and storing. The audit of the answer takes a part of it.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Final, Protocol

from worker.spec.errors import Problem, SpecInvalid, describe
from worker.sweep import AXES, SweepSpec
from worker.sweep.levels import WHOLE, Steps, cells, coarsest, finest, level
from worker.sweep.protocols import KINDS, PROTOCOLS

#: Share of a budget for the audit of the answer.
AUDIT: Final = 0.1
#: A sweep that takes less than this share, by the table of costs, has no coarser levels.
AT_ONCE: Final = 0.005
#: Largest part of the cells that fit in a level that measures the speed, and the same where no smaller one
#: contains the level before: what it takes is lost to the finest.
PROBE, LARGE_PROBE = 0.1, 0.3
#: A level measures the speed if it takes this share of the time that is left; or the second, if its time
#: cannot be told from that in which a level begins.
MEASURES, MEASURES_ALONE = 0.03, 0.2
#: Those times are told apart where all of a level's time is at most this multiple of that of its cells.
TOLD: Final = 1.2
#: Share for the end: stopping workers, moving the result.
END: Final = 0.02
#: Ending the process takes up to this part of what its start took; the share reserved for it at most.
ENDING, MOST_ENDING = 0.25, 0.1
#: No audit begins with fewer seconds left.
LEAST_AUDIT: Final = 1.0
#: Seconds that may be enough for a level.
LEAST: Final = 0.5
#: A level begins if this multiple of its expected time is left.
MARGIN: Final = 1.2


class Runner(Protocol):
    """Computes levels and audits them."""

    def seconds(self, spec: SweepSpec) -> float:
        """The expected time of a sweep, by the table of costs."""

    def is_done(self, spec: SweepSpec) -> bool:
        """Whether a sweep is complete."""

    def took(self, spec: SweepSpec) -> float:
        """The time that a complete sweep took; 0 if that is not known."""

    def compute(self, spec: SweepSpec, seconds: float) -> bool:
        """Compute a sweep for at most `seconds`; whether it is complete then."""

    def changed(self) -> float | None:
        """The share of the last complete level's cells where the one before it shows another mode.

        None if that cannot be read.
        """

    def audit(self, seconds: float) -> str | None:
        """Audit the last complete level for at most `seconds`; the sentence, None if it did not end."""


@dataclass(frozen=True)
class Level:
    """A complete level."""

    steps: Steps
    cells: int
    seconds: float  # that the level took, also where it was complete before; 0 if that is not known


@dataclass
class Answer:
    """The levels within a budget."""

    levels: list[Level] = field(default_factory=list)
    audit: str | None = None


def check(kind: object, budget: object) -> None:
    """Raise SpecInvalid for a kind of study without levels, and for a budget that is not a time."""
    is_time = isinstance(budget, int | float) and budget > 0.0
    rule = "" if is_time else f"must be seconds above 0, not {describe(budget)}"
    if kind in KINDS and kind not in PROTOCOLS:
        rule = f"is for sweeps; this study is of kind {kind}"
    if rule:
        raise SpecInvalid([Problem("budget", rule)])


def usable(budget: float, started: float) -> float:
    """Seconds between a start that took `started` seconds and the end, which takes some of a budget."""
    return budget - started - max(END * budget, min(ENDING * started, MOST_ENDING * budget))


def within(
    spec: SweepSpec,
    budget: float,
    runner: Runner,
    show: Callable[[str, float], None] = lambda _, left: None,
    clock: Callable[[], float] = time.monotonic,
    began: float | None = None,
    known: Steps | None = None,
) -> Answer:
    """Compute the finest level that fits into `budget` seconds. Raises SpecInvalid if none does.

    show: called with a text when a step begins, and with the seconds left. began: when the time began; by
    default now. known: steps of a level that may be complete.
    """
    began, answer = clock() if began is None else began, Answer()
    started = clock() - began
    whole_budget, budget = budget, started + usable(budget, started)
    reserved = AUDIT * budget
    whole, changed = cells(spec, WHOLE), ""
    by_table = whole / runner.seconds(spec)  # cells in a second
    complete = next((steps for steps in (WHOLE, known) if steps and runner.is_done(level(spec, steps))), None)
    steps: Steps | None = complete or (WHOLE if AT_ONCE * budget * by_table >= whole else coarsest(spec))
    while steps is not None:
        part, left = level(spec, steps), budget - (clock() - began)
        earlier = runner.took(part) if runner.is_done(part) else None
        said = f"{cells(spec, steps):,} cells{_thinning(steps)}{changed and '; the last level'}{changed}"
        show(said, max(left, 0.0))
        now = clock()
        # the first level may take all of the time: without it there is no answer
        if left <= 0.0 or not runner.compute(part, left - (reserved if answer.levels else 0.0)):
            break
        took = clock() - now if earlier is None else earlier
        share = runner.changed() if answer.levels else None
        changed = "" if share is None else f" changed {100.0 * share:.3g} % of the picture"
        answer.levels.append(Level(steps, cells(spec, steps), took))
        left = (budget - (clock() - began) - reserved) / MARGIN
        timed = [done for done in answer.levels if done.seconds > 0.0]
        if steps == WHOLE:
            break
        steps = _finer(spec, timed, steps, left, by_table)
    if not answer.levels:
        took = clock() - began
        rule = f"was over before the first level of {cells(part, WHOLE):,} cells was complete"
        enough = 2.0 * max(whole_budget, took, LEAST, runner.seconds(part))
        raise SpecInvalid([Problem("budget", f"{rule}; {enough:.3g}s may work")])
    left = budget - (clock() - began)
    ending = f"no audit within the time: less than {LEAST_AUDIT:g} s was left"
    if left >= LEAST_AUDIT:
        show(f"audit of the last level{changed and ', which'}{changed}", left)
        answer.audit = runner.audit(left)
        ending = answer.audit or "no audit within the time: it would have taken longer"
    show(ending, 0.0)
    return answer


def _finer(
    spec: SweepSpec, levels: Sequence[Level], steps: Steps, seconds: float, by_table: float
) -> Steps | None:
    """The steps of the next level after `steps`; None if none fits into `seconds`.

    levels: those that were timed. by_table: cells in a second, where nothing was measured.
    """
    # without a measurement only the table gives the speed, which may be wrong by half
    rate, start, told = _speed(levels) if levels else (2.0 / by_table, 0.0, False)
    most = (seconds - start) / rate
    if not levels or levels[-1].seconds < (MEASURES if told else MEASURES_ALONE) * seconds:
        probe = finest(spec, PROBE * most, steps) or coarsest(spec, steps)
        if cells(spec, probe) <= LARGE_PROBE * most:
            return probe
    # the first level may have waited for other work: another one measures the speed
    waited = None if told else finest(spec, PROBE * seconds * by_table, steps)
    return finest(spec, most, steps) or waited


def _speed(levels: Sequence[Level]) -> tuple[float, float, bool]:
    """Seconds of a cell, and those in which a level begins, and whether two levels tell them apart.

    If they do not, all of the last level's time counts as that of its cells, which is too much. The first
    level may have waited for its kernel to compile.
    """
    *before, last = levels
    rate = last.seconds / last.cells
    slope = (last.seconds - before[-1].seconds) / (last.cells - before[-1].cells) if before else 0.0
    if TOLD * slope < rate:
        return rate, 0.0, False
    slope = min(slope, rate)
    return slope, last.seconds - slope * last.cells, True


def _thinning(steps: Steps) -> str:
    """The values that a level takes of each axis, in words: `, every 3rd gamma`."""
    pairs = zip(AXES, steps, strict=True)
    named = [f"{_part(step)} {axis}" for axis, step in pairs if step > 1]
    return f", {' and '.join(named)}" if named else ""


def _part(step: Fraction) -> str:
    values, kept = step.as_integer_ratio()
    ending = {2: "nd", 3: "rd", 32: "nd"}.get(values, "th")
    return f"every {values}{ending}" if kept == 1 else f"{kept} of {values}"
