"""The choices of queries: file formats, named by their file endings, and predictions.

Standard library only: the client and the command line import this without the service.
"""

from collections.abc import Mapping
from typing import Final, Literal, get_args

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
