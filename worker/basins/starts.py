"""Starts of cells, and chunks computed in steps of one or more runs of many starts (docs/basins.md)."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.interface import prepare, rest
from kernel.line import LineRun
from kernel.params import STATE_FIELDS, Line
from worker.basins.specification import GridSpec
from worker.spec.contact_models import Contact
from worker.work import Work, plate_at, plate_of

_ANSWER: Final = "answer/"

_Arrays = dict[str, NDArray[Any]]
_Floats = NDArray[np.float64]


def starts_of(spec: GridSpec, gamma: float, omega: float, xi: float) -> _Floats:
    """The states (rows * columns, 6) of a cell's plane of starts, row by row (see params.STATE_FIELDS)."""
    plane = spec.protocol
    row, column = np.meshgrid(plane.row_values, plane.column_values, indexing="ij")
    if plane.plane == "drop":
        states = drop_states(row, column)
    else:
        states = contact_states(spec.model, (gamma, omega, xi), row, column)
    return states.reshape(-1, len(STATE_FIELDS))


def drop_states(height: _Floats, phase: _Floats) -> _Floats:
    """The states (…, 6) of a relaxed spring at rest in the laboratory, released at a plate phase, rad.

    height (…): of the lower mass above the plate, plate amplitudes.
    """
    states = np.zeros((*height.shape, len(STATE_FIELDS)))
    states[..., 0], states[..., 1], states[..., 2] = phase, 1.0, height
    states[..., 3] = np.sin(phase)  # relative to the plate, which moves as cos(phase)
    return states


def contact_states(
    model: Contact, cell: tuple[float, float, float], elongation: _Floats, velocity: _Floats
) -> _Floats:
    """The states (…, 6) of a spring whose lower mass sticks to the plate at phase 0.

    cell: gamma, omega, xi. elongation (…): beyond the static one, plate amplitudes; velocity (…): of the
    elongation, times omega, in the same unit.
    """
    _, omega, _ = cell
    states = np.zeros((*elongation.shape, len(STATE_FIELDS)))
    states[..., 2:] = rest(prepare(plate_at(model, *cell), 0, *cell))
    states[..., 4] += elongation
    states[..., 5] += velocity / omega
    return states


def run_of_starts(spec: GridSpec, cells: Sequence[_Floats], **window: Any) -> LineRun:
    """A run of n starts of `cells`, gamma, omega, xi (n,), at its beginning.

    window: further arguments of `LineRun`, such as `states` (n, 6).
    """
    plate = plate_of(spec.model, *cells)
    return LineRun(*cells, plate=plate, carry=False, micro_flight=spec.micro_flight, **window)


class Steps(Work):
    """The record of a chunk, its finished steps, and the answers of the step under way."""

    def __init__(self, *arguments: Any) -> None:
        self._answers: list[_Arrays] = []
        self._answered = 0
        super().__init__(*arguments)

    def answer(
        self, spec: GridSpec, cells: Sequence[_Floats], reduce: Callable[[Line], _Arrays], **window: Any
    ) -> _Arrays:
        """The arrays that `reduce` returns for the step's next run, computed now or in an earlier slice.

        cells, window: as for `run_of_starts`. Raises ChunkCancelled, ChunkPaused.
        """
        if self._answered == len(self._answers):
            self._answers.append(reduce(self.compute(run_of_starts(spec, cells, **window))))
            self.pause_if_due({})
        self._answered += 1
        return self._answers[self._answered - 1]

    def finish_step(self) -> None:
        """Note that the step's results are in the record."""
        self.done += 1
        self._answers, self._answered = [], 0

    def _save(self) -> _Arrays:
        arrays = super()._save()
        for number, answer in enumerate(self._answers):
            arrays |= {f"{_ANSWER}{number}/{name}": array for name, array in answer.items()}
        return arrays

    def _restore(self, saved: _Arrays) -> None:
        super()._restore(saved)
        answers: dict[int, _Arrays] = {}
        for name, array in saved.items():
            if name.startswith(_ANSWER):
                number, field = name.removeprefix(_ANSWER).split("/")
                answers.setdefault(int(number), {})[field] = array
        self._answers = [answers[number] for number in range(len(answers))]
