"""A chunk computed in steps, each of one or more runs of many starts."""

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.line import LineRun
from kernel.params import Line
from worker.basins.spec import GridSpec
from worker.grid_plan import Block
from worker.schema import Array
from worker.tasks import Work, plate_of

_ANSWER: Final = "answer/"

_Arrays = dict[str, NDArray[Any]]


class Steps(Work):
    """The record of a chunk, its finished steps, and the answers of the step under way."""

    def __init__(self, store_url: str, chunk: Block, arrays: Iterable[Array], record: _Arrays) -> None:
        self._answers: list[_Arrays] = []
        self._answered = 0
        super().__init__(store_url, chunk, arrays, record)

    def answer(self, run: Callable[[], LineRun], reduce: Callable[[Line], _Arrays]) -> _Arrays:
        """The part that `reduce` keeps of the step's next run, computed now or before.

        Raises ChunkCancelled, ChunkPaused.
        """
        if self._answered == len(self._answers):
            self._answers.append(reduce(self.compute(run())))
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


def line_run(
    spec: GridSpec,
    cells: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    states: NDArray[np.float64],
    **window: Any,
) -> LineRun:
    """A run of starts (n, 6), each in its cell: gamma, omega, xi (n,). `window`: as in `LineRun`."""
    plate = plate_of(spec.model, *cells)
    return LineRun(*cells, plate=plate, carry=False, micro_flight=spec.micro_flight, states=states, **window)
