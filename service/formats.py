"""The choices of queries: file formats, named by their file endings, and predictions; and what reads results.

Standard library only: the client and the command line import this without the service.
"""

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, TypeAlias, get_args

if TYPE_CHECKING:
    import xarray

#: A result as a Dataset, and its table.
DatasetFormat = Literal["json", "bin", "nc", "csv", "parquet"]
#: A whole study in one file; html: a sweep as a page that needs no service.
ExportFormat = Literal["nc", "parquet", "html"]
#: The rows of an exported table: cells, or attractors of cells; or their flights.
ExportLayout = Literal["cells", "flights"]

#: The thresholds of a sweep that are predicted: none, those of up to 200 values of omega, all; all from
#: cycles of the sweep's cells, or all by a search.
Predict = Literal["none", "some", "all", "cells", "search"]

#: Limit on the bytes of a shared file that is imported.
MOST_SHARED: Final = 32 * 2**20

TABLES: Final = ("json", "csv")
PICTURES: Final = ("png", "svg", "pdf")
EXPORTS: Final[tuple[str, ...]] = get_args(ExportFormat)

MEDIA_TYPES: Final[Mapping[str, str]] = {
    "json": "application/json",
    "csv": "text/csv",
    "png": "image/png",
    "svg": "image/svg+xml",
    "pdf": "application/pdf",
    "bin": "application/octet-stream",
    "nc": "application/x-netcdf",
    "parquet": "application/vnd.apache.parquet",
    "html": "text/html",
}

#: Seconds of the units of a time.
_UNITS: Final = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


def seconds_of(text: object) -> float:
    """The seconds of a time written as 90, 90s, 5m or 1.5h. Raises ValueError."""
    match = re.fullmatch(r"\s*((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(s|m|min|h|)\s*", str(text), re.ASCII)
    if match is None or not (seconds := float(match[1]) * _UNITS[match[2]]):
        raise ValueError(f"must be seconds above 0, or a time such as 90s, 5m or 1h, not {str(text)!r:.40}")
    return seconds


#: The formats of each result, and the variables whose numbers are the rows of printed tables.
Results: TypeAlias = dict[str, tuple[tuple[str, ...], tuple[str, ...]]]
#: Whether progress is shown, or what is called with the number of parts computed and that of all.
Progress: TypeAlias = bool | Callable[[int, int], None]


class Methods:
    """Reads results by name."""

    RESULTS: ClassVar[Results]

    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name."""
        raise NotImplementedError
