"""Tables of cases that one test goes through."""

import inspect
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import Any

import pytest


def for_each(names: str | Sequence[str], rows: Iterable[Any]) -> Callable[[Callable[..., None]], Any]:
    """Like `pytest.mark.parametrize`, but one test for the whole table, which says which rows fail.

    For rows that cost less than the ten milliseconds of a test of its own; the rows share its fixtures.
    """
    keys = (names,) if isinstance(names, str) else tuple(names)
    table = [row.values if hasattr(row, "marks") else (row,) if len(keys) == 1 else row for row in rows]
    assert table, f"no rows of {keys}"

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(test)
        fixtures = [parameter for name, parameter in signature.parameters.items() if name not in keys]

        @wraps(test)
        def whole(**given: Any) -> None:
            failed = []
            for row in table:
                try:
                    test(**dict(zip(keys, row, strict=True)), **given)
                except (Exception, pytest.fail.Exception) as error:  # noqa: BLE001 - raised below
                    failed.append((row, error))
            if failed:
                error = failed[0][1]
                rows = "".join(f"\n  {row!r:.200}" for row, _ in failed)
                error.add_note(f"{len(failed)} of {len(table)} rows of {keys} fail, this is the first:{rows}")
                raise error

        whole.__signature__ = signature.replace(parameters=fixtures)  # type: ignore[attr-defined]
        return whole

    return decorate
