"""Adaptive maps: the cells of a tile to compute, round by round, and the values of the others.

A tile is a block of cells over (omega, gamma), cut into blocks whose corners are cells that neighbours share.
The corners and the centre of a block are computed. A block with computed cells of different classes is split
at its centre; corners of smaller neighbours on its edge count, so that a thin tongue is followed. In the
smallest blocks, 3 x 3 cells, the cell between two corners is computed only where these and the centre differ.
Chaotic regions are full of islands, which five samples miss: in a block without a mode the middles of the
edges are computed too.

A cell that is not computed takes the values of its block's nearest vertex.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from worker.spec.refine import MAX_MODE_PERIODS, Refine
from worker.sweep import SweepSpec

#: Blocks: rows and columns of the first and last corner.
_Blocks = NDArray[np.int64]  # (n, 4)
#: Rows and columns of cells.
_Points = tuple[NDArray[np.int64], NDArray[np.int64]]

#: Rows and columns from the first to the last corner of the smallest blocks that are split.
_SMALLEST: Final = 2

#: Classes of cells: by bouncing, these outcomes are one; by mode, each outcome and each short mode is one.
_BOUNCES: Final = (Outcome.PERIODIC, Outcome.APERIODIC, Outcome.SETTLING)
_WITHOUT_MODE: Final = (Outcome.APERIODIC, Outcome.SETTLING)
_MODES: Final = len(Outcome)


def refine_of(spec: SweepSpec) -> Refine:
    """How a map is refined. Raises TypeError for a sweep that computes every cell."""
    if spec.refine is None:
        raise TypeError("the sweep computes every cell: it is no adaptive map")
    return spec.refine


def classes(
    refine: Refine, outcome: NDArray[Any], bounces: NDArray[Any], periods: NDArray[Any]
) -> NDArray[np.int64]:
    """The class of each cell, in the arrays' shape.

    By bouncing: at rest, unresolved, diverged, any other. By mode the last is divided: each mode of up to
    MAX_MODE_PERIODS plate periods is a class, all longer ones are one, aperiodic and settling cells are two.
    """
    kinds = outcome.astype(np.int64)
    if refine.by == "bouncing":
        return np.where(np.isin(kinds, _BOUNCES), Outcome.PERIODIC, kinds)
    short = (outcome == Outcome.PERIODIC) & (periods <= MAX_MODE_PERIODS)
    return np.where(short, _MODES + bounces.astype(np.int64) * (MAX_MODE_PERIODS + 1) + periods, kinds)


class Tile:
    """The rounds of one tile of `shape` = (rows, columns) cells; they depend on these cells alone."""

    def __init__(self, shape: tuple[int, ...], refine: Refine) -> None:
        self._refine = refine
        self._computed: NDArray[np.bool_] = np.zeros(shape, np.bool_)
        self._wanted = self._computed.copy()
        self._blocks = _coarsest(shape, refine.coarsest)
        self._want_vertices()

    @property
    def cells(self) -> NDArray[np.int64]:
        """Flat indices of this round's cells; empty at the end."""
        return np.flatnonzero(self._wanted & ~self._computed)

    def split(self, outcome: NDArray[Any], bounces: NDArray[Any], periods: NDArray[Any]) -> None:
        """Take the results of the round's cells and split blocks; arrays over the tile."""
        self._computed |= self._wanted
        kinds = classes(self._refine, outcome, bounces, periods)
        splits = self._differing(kinds)
        small = np.all(_sizes(self._blocks) == _SMALLEST, axis=1)
        self._want_between(kinds, self._blocks[splits & small])
        splits &= ~small & np.any(_sizes(self._blocks) > 1, axis=1)
        self._blocks = np.concatenate([self._blocks[~splits], _children(self._blocks[splits])])
        self._want_vertices()
        self._want_middles(kinds)

    def sources(self) -> NDArray[np.int64]:
        """For each cell of the tile, flat, the index of the cell to copy (its own if computed)."""
        rows, columns = self._computed.shape
        source = np.arange(rows * columns).reshape(rows, columns)
        # A row or column shared by two blocks belongs to the later one, except at the tile's ends: each block
        # first takes its whole span, then its own part.
        for ends in (1, 0):
            for size, same in _by_size(self._blocks):
                row, column = np.ogrid[: size[0] + ends, : size[1] + ends]
                top, left = self._blocks[same, 0, None, None], self._blocks[same, 2, None, None]
                at_row, at_column = _nearest(size, row, column)
                source[top + row, left + column] = (top + at_row) * columns + left + at_column
        return np.where(self._computed.ravel(), np.arange(rows * columns), source.ravel())

    def _differing(self, kinds: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(n,) the blocks with computed cells of different classes."""
        differs = np.zeros(len(self._blocks), np.bool_)
        for size, which in _by_size(self._blocks):
            row, column = np.ogrid[: size[0] + 1, : size[1] + 1]
            cells = self._blocks[which, 0, None, None] + row, self._blocks[which, 2, None, None] + column
            classes = kinds[cells]
            differs[which] = np.any((classes != classes[:, :1, :1]) & self._computed[cells], axis=(1, 2))
        return differs

    def _want_between(self, kinds: NDArray[np.int64], blocks: _Blocks) -> None:
        """Request the cells on the edges of the smallest blocks, where the corners or the centre differ."""
        top, left = blocks[:, 0], blocks[:, 2]
        centre = kinds[top + 1, left + 1]
        for row, column in ((0, 1), (1, 0), (2, 1), (1, 2)):  # between two corners
            corners = ((row, 0), (row, 2)) if column == 1 else ((0, column), (2, column))
            first, last = (kinds[top + i, left + j] for i, j in corners)
            differs = (first != last) | (first != centre)
            self._wanted[top[differs] + row, left[differs] + column] = True

    def _want_vertices(self) -> None:
        for point in _vertices(self._blocks):
            self._wanted[point] = True

    def _want_middles(self, kinds: NDArray[np.int64]) -> None:
        """Request the middles of the edges of blocks with a corner or centre without a mode."""
        if self._refine.by == "bouncing":
            return
        points = _vertices(self._blocks)
        without = [np.isin(kinds[point], _WITHOUT_MODE) & self._computed[point] for point in points]
        top, bottom, left, right = self._blocks[np.any(without, axis=0)].T
        row, column = (top + bottom) // 2, (left + right) // 2
        for point in ((top, column), (bottom, column), (row, left), (row, right)):
            self._wanted[point] = True


def _coarsest(shape: tuple[int, ...], width: int) -> _Blocks:
    """The first blocks of a tile, of `width` rows and columns; the last ones may be narrower."""
    rows, columns = (
        [(low, min(low + width, n - 1)) for low in range(0, max(n - 1, 1), width)] for n in shape
    )
    return np.array([(*row, *column) for row in rows for column in columns], np.int64)


def _vertices(blocks: _Blocks) -> list[_Points]:
    """The corners, in the order of the rows, and the centre of every block."""
    top, bottom, left, right = blocks.T
    return [*((row, column) for row in (top, bottom) for column in (left, right)), _centre(blocks)]


def _centre(blocks: _Blocks) -> _Points:
    top, bottom, left, right = blocks.T
    return (top + bottom) // 2, (left + right) // 2


def _sizes(blocks: _Blocks) -> NDArray[np.int64]:
    """(n, 2) rows and columns from the first to the last corner of every block."""
    return blocks[:, 1::2] - blocks[:, ::2]


def _by_size(blocks: _Blocks) -> Iterator[tuple[tuple[int, int], NDArray[np.int64]]]:
    """Each size of block, with the indices of its blocks."""
    sizes = _sizes(blocks)
    for rows, columns in np.unique(sizes, axis=0).tolist():
        yield (rows, columns), np.flatnonzero((sizes[:, 0] == rows) & (sizes[:, 1] == columns))


def _children(blocks: _Blocks) -> _Blocks:
    """The parts of every block, cut at its centre."""
    top, bottom, left, right = blocks.T
    row, column = _centre(blocks)
    tall, wide = bottom - top > 1, right - left > 1
    row_end, column_end = np.where(tall, row, bottom), np.where(wide, column, right)
    parts = (
        (tall | wide, (top, row_end, left, column_end)),
        (wide, (top, row_end, column, right)),
        (tall, (row, bottom, left, column_end)),
        (tall & wide, (row, bottom, column, right)),
    )
    return np.concatenate([np.stack(spans, axis=1)[exists] for exists, spans in parts])


def _nearest(size: tuple[int, int], row: NDArray[Any], column: NDArray[Any]) -> _Points:
    """The vertex nearest to each (row, column) from a block's first corner; the first among equals."""
    points = np.array(_vertices(np.array([[0, size[0], 0, size[1]]])))[:, :, 0]
    distance = [(row - at_row) ** 2 + (column - at_column) ** 2 for at_row, at_column in points]
    nearest = points[np.argmin(distance, axis=0)]
    return nearest[..., 0], nearest[..., 1]
