"""Measured points for a plot: a table with an axis, flight times or thresholds, and perhaps errors."""

import json
import math
import re
import warnings
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from worker.spec.errors import BounceError

if TYPE_CHECKING:
    import pandas

#: A CSV file, or a table of these columns.
Data: TypeAlias = "str | PathLike[str] | pandas.DataFrame | Mapping[str, Any]"

MOST_ROWS: Final = 100_000
_NEAR: Final = 1e-6  # relative, of values that are the same
_EMPTY: Final = "(-?nan?|<na>|nat|n/a|null|none)?"  # as in views/measured.js
_COLUMNS: Final = ("gamma", "omega", "xi", "flight_time", "flight_time_ms", "frequency", "error")


class Measured(NamedTuple):
    """n points of a plot; `error` is half the length of the error bars, NaN without."""

    x: NDArray[np.float64]  # (n,)
    y: NDArray[np.float64]  # (n,) rad, or Gamma of a threshold
    error: NDArray[np.float64]  # (n,)


def measured(
    data: Data, along: str, value: str, at: Mapping[str, float], frequency: float | None = None
) -> Measured:
    """The points of `data` over the axis `along`, of a `value`: "flight_time" in rad, or "gamma".

    Leaves out rows without both values, and points whose columns differ from the values `at` of other axes.

    Flight times are in rad of the plate (`flight_time`), or in ms (`flight_time_ms`) with the plate's
    `frequency` in Hz as an argument or a column. `error` has the unit of its value. Raises BounceError naming
    the column, or the row, from 1.
    """
    table = _table(data, frequency)
    y, factor = value, np.ones(len(table))
    if value == "flight_time" and "flight_time_ms" in table:
        if "frequency" not in table:
            raise BounceError("data: flight_time_ms needs the plate's frequency in Hz, as a column")
        y, factor = "flight_time_ms", 2.0 * math.pi * table["frequency"].to_numpy() / 1000.0
    for name in (along, y):
        if name not in table:
            also = " or flight_time_ms" if name == "flight_time" else ""
            columns = ", ".join(map(str, table)) or "none"
            raise BounceError(f"data: needs the column {name}{also}; it has {columns}")
    table = table.assign(y=table[y] * factor, error=table.get("error", math.nan) * factor)
    table = table.dropna(subset=[along, "y"])
    if table.empty:
        raise BounceError(f"data: no row has {along} and {y}")
    for name in at.keys() & set(table):
        table = table[~((table[name] - at[name]).abs() > _NEAR * at[name])]
    if table.empty:
        place = ", ".join(f"{axis} = {at[axis]:g}" for axis in sorted(at))
        raise BounceError(f"data: no point is at {place}")
    return Measured(*(table[column].to_numpy() for column in (along, "y", "error")))


def element(data: Data) -> str:
    """Measured points as an element of a shared page, for views/measured.js. Raises BounceError."""
    table = _table(data)
    name = Path(data).name if isinstance(data, str | PathLike) else "data"
    value = "flight_time" if {"flight_time", "flight_time_ms"} & set(table) else "gamma"
    along = "omega" if value == "gamma" else next((axis for axis in _COLUMNS[:3] if axis in table), "gamma")
    measured(table, along, value, {})
    points = {"value": value, "name": name, "text": table.to_csv(index=False)}
    files = json.dumps([points]).replace("<", "\\u003c")
    return f'<script type="application/json" id="measured">{files}</script>'


def _table(data: Data, frequency: float | None = None) -> "pandas.DataFrame":
    """The columns as numbers, NaN where a cell is empty. Raises BounceError."""
    import pandas

    if isinstance(data, str | PathLike):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", pandas.errors.ParserWarning)  # of cells beyond the columns
                read = pandas.read_csv(
                    data, comment="#", skipinitialspace=True, index_col=False, nrows=MOST_ROWS + 1, dtype=str
                )
        except (pandas.errors.ParserWarning, pandas.errors.ParserError) as error:
            rule = "a row has more cells than there are columns, or an open quote"
            line = "".join(f" ({line})" for line in re.findall(r"line \d+", str(error)))
            raise BounceError(f"data: {rule}{line}; commas separate columns, points decimals") from None
        except ValueError:
            raise BounceError(f"data: {data} is empty or no text (UTF-8) of columns with commas") from None
        unnamed = read.columns.str.startswith("Unnamed: ") & read.isna().all()  # below a comma too many
        data = read.loc[:, ~unnamed].rename(columns=str.strip)
    try:
        table = pandas.DataFrame(data)
        table = table if frequency is None else table.assign(frequency=frequency)
    except ValueError:
        rule = "must be a CSV file, or a table or mapping of columns of one length"
        raise BounceError(f"data: {rule}, not {data!r:.40}") from None
    if len(table) > MOST_ROWS:
        raise BounceError(f"data: has more than {MOST_ROWS:,} rows")
    if unknown := [str(name) for name in table if name not in _COLUMNS]:
        raise BounceError(f"data: {unknown[0]:.40} is no column here; these are {', '.join(_COLUMNS)}")
    numbers = {}
    for name in table:
        # as texts, of which True and dates are no numbers
        cells = pandas.Series([str(cell).strip() for cell in table[name]], dtype=object)
        x = numbers[name] = pandas.to_numeric(cells, errors="coerce").to_numpy(float)
        low, rule = (x <= 0.0, "above 0") if name == "frequency" else (x < 0.0, "of 0 or more")
        for row in np.flatnonzero(low | (~np.isfinite(x) & ~cells.str.fullmatch(_EMPTY, case=False))):
            value = f"{name} of row {row + 1}"
            raise BounceError(f"data: {value} must be a number {rule}, not {cells[row]!r:.40}")
    return pandas.DataFrame(numbers)
