"""Division of a grid of cells into independent chunks, for studies other than sweeps."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

from worker.plan import Span


@dataclass(frozen=True, slots=True)
class Block:
    """A block of cells: half-open index spans along each cell dimension. Blocks are independent."""

    index: int
    spans: tuple[Span, ...]
    after: None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each cell dimension."""
        return tuple(high - low for low, high in self.spans)

    @property
    def cells(self) -> int:
        return math.prod(self.shape)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Its cells along each cell dimension."""
        return tuple(slice(*span) for span in self.spans)


@dataclass(frozen=True)
class GridPlan(Sequence[Block]):
    """The blocks of a grid of cells, the last dimension fastest. Raises ValueError for a size below 1."""

    grid: tuple[int, ...]  # cells along each cell dimension
    chunk_shape: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.chunk_shape) != len(self.grid) or min(self.chunk_shape) < 1:
            raise ValueError(
                f"chunk_shape: must be {len(self.grid)} sizes of at least 1, not {self.chunk_shape}"
            )
        fitting = tuple(min(size, n) for size, n in zip(self.chunk_shape, self.grid, strict=True))
        object.__setattr__(self, "chunk_shape", fitting)

    @property
    def cells(self) -> int:
        return math.prod(self.grid)

    @property
    def lines(self) -> int:
        return len(self)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Chunks along each cell dimension."""
        return tuple(-(-n // size) for n, size in zip(self.grid, self.chunk_shape, strict=True))

    def __len__(self) -> int:
        return math.prod(self.counts)

    def __iter__(self) -> Iterator[Block]:
        return map(self.__getitem__, range(len(self)))

    @overload
    def __getitem__(self, index: int) -> Block: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Block]: ...
    def __getitem__(self, index: int | slice) -> Block | Sequence[Block]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        index = rest = range(len(self))[index]
        spans: list[Span] = []
        for n, size, count in reversed(list(zip(self.grid, self.chunk_shape, self.counts, strict=True))):
            rest, coord = divmod(rest, count)
            spans.append((coord * size, min((coord + 1) * size, n)))
        return Block(index, tuple(reversed(spans)))

    def number(self, *coords: int) -> int:
        """Index of the chunk at these coordinates in the grid of chunks."""
        index = 0
        for coord, count in zip(coords, self.counts, strict=True):
            index = index * count + coord
        return index
