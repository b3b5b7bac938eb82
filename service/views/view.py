"""The parts of a result: its query, its cost, its computation as a Dataset, and its picture."""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from types import UnionType
from typing import Annotated, Any, Final, Literal

import xarray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from service.formats import PICTURES, seconds_of
from service.pictures import CLASS_NAMES, Figure
from service.views import encode
from worker.spec.axes import LARGEST, SMALLEST, within
from worker.study import Array

Number = Annotated[float, Field(allow_inf_nan=False)]
#: Reads a time as seconds, or text such as 5m.
SECONDS: Final = BeforeValidator(seconds_of, json_schema_input_type=float | str)
Every = Annotated[int, Field(ge=1, le=1_000_000, description="return every n-th value only")]

#: Parameters of a spring, with the limits of a specification.
Omega = Annotated[Number, Field(ge=SMALLEST, le=LARGEST)]
Xi = Annotated[Number, Field(ge=0, le=LARGEST), AfterValidator(within(0.0, LARGEST))]

Log = Annotated[
    Literal["none", "x", "y", "xy"] | None,
    Field(description="logarithmic axes of a picture; default: those of values in equal ratios"),
]

Direction = Annotated[
    str | None, Field(description="rest, up or down; default: every direction of the sweep")
]
FirstDirection = Annotated[
    str | None, Field(description="rest, up or down; default: the first direction of the sweep")
]
MinFlight = Annotated[
    Number | None,
    Field(
        ge=0, description="rad; shorter flights do not count, unless all of a cell are; default: micro_flight"
    ),
]


def _classes(names: str) -> str:
    if unknown := [name for name in names.split(",") if name not in CLASS_NAMES]:
        raise ValueError(f"must be among {', '.join(CLASS_NAMES)}, not {unknown[0]!r}")
    return names


Hide = Annotated[
    Annotated[str, Field(max_length=400), AfterValidator(_classes)] | None,
    Field(
        description="classes left out: at_rest and other labels, cycles as 2-fewer, 2-equal, 2-more, longer; "
        "of a map by multiplier also multiplier-0.2 to multiplier-1"
    ),
]

#: Limit on the core-seconds of closed forms that are computed while the caller waits.
AT_ONCE_SECONDS: Final = 1.0
#: Limit on the core-seconds of closed forms that the service computes in its own process.
SMALL_SECONDS: Final = 0.1

#: A function of `worker` and its arguments, which can be hashed.
Call = tuple[Any, ...]


class Query(BaseModel):
    """The parameters of a view. Unknown parameters are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class Estimate:
    """The size of an answer, known from specification and query alone."""

    lengths: Mapping[str, int]  # of the largest variable, by dimension, before thinning
    thinned: tuple[str, ...] = ()  # dimensions that `every` thins
    every: int = 1
    reads: tuple[str, ...] = ()  # cell dimensions whose chunks are all read
    memory: int = 0  # bytes for reading and computing, beside the answer
    most: int | None = None  # limit on the points, if it is lower than that of answers
    seconds: float = 0.0  # of computing during the request
    small: bool = True  # whether the computation is quick, whatever the size of the read

    @property
    def sizes(self) -> dict[str, int]:
        """Lengths after thinning."""
        return {dim: -(-n // self.every) if dim in self.thinned else n for dim, n in self.lengths.items()}

    @property
    def points(self) -> int:
        """Numbers of the largest variable."""
        return prod(self.sizes.values())

    def fitting(self, max_points: int) -> int | None:
        """The smallest `every` with at most `max_points` points; None if there is none."""
        steps = range(1, max((self.lengths[dim] for dim in self.thinned), default=0) + 1)
        first = bisect_left(steps, True, key=lambda every: replace(self, every=every).points <= max_points)
        return steps[first] if first < len(steps) else None


@dataclass(frozen=True)
class View:
    """One result, of a job or of a spring alone.

    `compute(study, query, *parts)`, of a spring `compute(None, query, *parts)`, returns the Dataset, with
    the attribute `complete`. It raises errors of `service.errors` and `store.StoreError`. Its docstring
    documents the HTTP operation, the client's method and the command.
    """

    name: str  # of the path, the client's method and the command
    summary: str
    study: type[Any] | UnionType | None  # the class of the specifications that have this; None: needs no job
    query: type[Query]
    compute: Callable[..., xarray.Dataset]
    estimate: Callable[[Any, Any], Estimate]  # of specification and query
    variables: tuple[Array, ...]  # that the Dataset can have
    rows: str | None = None  # the variable whose numbers are the rows of a table
    finer_rows: str | None = None  # the variable that replaces `rows` if the Dataset has it
    printed: tuple[str, ...] = ()  # rows of the tables that the command prints; default: `rows`
    draw: Callable[[xarray.Dataset, Figure], None] | None = None
    size: tuple[float, float] = (6.8, 4.2)  # of the picture, inches
    #: Whose threads compute it (`service.api.capacity`); default: of "on demand" with `parts`, else "read".
    activity: Literal["read", "trajectory"] | None = None
    #: Calls that workers compute first: functions of `worker` with their arguments. `compute` gets the
    #: results in this order. Without calls `compute` does all work, which then takes less than
    #: AT_ONCE_SECONDS. Calls of one function stand together. Calls that read a job's store have its address
    #: as an argument.
    parts: Callable[[Any, Any], Sequence[Call]] | None = None
    #: Whether the results of the calls, plain JSON values, are kept with the job. The attribute `sentence` of
    #: the Dataset then describes the job in files and pictures.
    kept: bool = False

    @property
    def described(self) -> list[str]:
        """One line of text for each variable: name, units, meaning."""
        lines = []
        for row in self.variables:
            units = row.attrs.get("units", "1")
            lines.append(f"- `{row.name}`{'' if units == '1' else f' ({units})'}: {row.attrs['long_name']}")
        return lines

    @property
    def formats(self) -> tuple[str, ...]:
        """The formats of this result, the default first."""
        tables = tuple(encode.TABLES) if self.rows is not None else ()
        return (*encode.DATASETS, *tables, *(PICTURES if self.draw is not None else ()))
