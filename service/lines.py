"""Lines of cells for sliders: what one read of the store brings along is kept for the next moves.

A stored chunk holds many lines and is only read as a whole, so the lines beside the one asked for cost
nothing but memory. Only finished jobs: what is stored of them never changes again.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from service import queries
from service.queries import Sweep
from worker.spec import AXES, SweepSpec

#: Bytes of flight times read at once, and kept in all.
BLOCK_BYTES: Final = 16 * 2**20
KEPT_BYTES: Final = 128 * 2**20

#: What a line is made of; flight times in single precision, which is more than a screen shows.
ARRAYS: Final = ("flight_time", "flights", "outcome", "bounces", "periods")

Arrays: TypeAlias = dict[str, NDArray[Any]]

#: Reads a line: (sweep, axis along which it goes, direction, grid indices of the other axes).
Reader: TypeAlias = Callable[[Sweep, str, str, Mapping[str, int]], Arrays]


def read(sweep: Sweep, along: str, direction: str, places: Mapping[str, int]) -> Arrays:
    """The arrays of one line, (n,) and (n, keep), from the store; what is not computed yet reads as missing.

    Raises as `store.read_slice`.
    """
    return _single(queries.read(sweep, ARRAYS, direction, places))


class Lines:
    """Blocks of neighbouring lines, the last used ones, for all jobs together. Safe between threads."""

    def __init__(self, most_bytes: int = KEPT_BYTES) -> None:
        self._most = most_bytes
        self._blocks: OrderedDict[tuple[object, ...], Arrays] = OrderedDict()
        self._lock = threading.Lock()

    def read(
        self,
        sweep: Sweep,
        along: str,
        direction: str,
        places: Mapping[str, int],
        chunk_shape: tuple[int, int, int],
    ) -> Arrays:
        """As the function of the same name, for a sweep that is done, cut into chunks of that shape."""
        beside = "omega" if along == "gamma" else "gamma"
        size = _block_size(sweep.spec, chunk_shape, along, beside)
        block, inside = divmod(places[beside], size)
        key = (sweep.url, along, direction, *(places[axis] for axis in places if axis != beside), block)
        found = self._kept(key)
        if found is None:
            where: queries.Places = {**places, beside: slice(block * size, (block + 1) * size)}
            found = _single(queries.read(sweep, ARRAYS, direction, where))
            self._keep(key, found)
        axis = 0 if AXES.index(beside) < AXES.index(along) else 1
        return {name: array.take(inside, axis=axis) for name, array in found.items()}

    def _kept(self, key: tuple[object, ...]) -> Arrays | None:
        with self._lock:
            if key in self._blocks:
                self._blocks.move_to_end(key)
            return self._blocks.get(key)

    def _keep(self, key: tuple[object, ...], block: Arrays) -> None:
        with self._lock:
            self._blocks[key] = block
            while len(self._blocks) > 1 and sum(map(_size, self._blocks.values())) > self._most:
                self._blocks.popitem(last=False)


def _block_size(spec: SweepSpec, chunk_shape: tuple[int, int, int], along: str, beside: str) -> int:
    """Lines in a block: as many as a stored chunk has anyway, if they are not too large."""
    line_bytes = 8 * spec.keep * len(spec.axis_values(along))
    return max(1, min(chunk_shape[AXES.index(beside)], BLOCK_BYTES // line_bytes))


def _single(found: Arrays) -> Arrays:
    return {**found, "flight_time": found["flight_time"].astype(np.float32)}


def _size(block: Arrays) -> int:
    return sum(array.nbytes for array in block.values())
