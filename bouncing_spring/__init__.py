"""The bouncing spring in one import: functions that run here, the client, and the parts of a specification.

    from bouncing_spring import Client, run, thresholds

Has all names of `service.client`, with the classes of a sweep and its errors. Importing this module loads no
numerical library.
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

#: The project's packages. Other projects may have packages of the same names.
_PACKAGES: Final = ("kernel", "service", "worker")


def _check_packages() -> None:
    """Raise ImportError if another package hides one of the project's."""
    for name in _PACKAGES:
        spec = find_spec(name)
        places = [*(spec.submodule_search_locations or (spec.origin or "",))] if spec else [""]
        if Path(places[0]).resolve() != Path(__file__).resolve().parents[1] / name:
            raise ImportError(
                f"{places[0]} hides the package {name} of bouncing-spring: rename it, or start elsewhere"
            )


_check_packages()

from service import client as _client  # noqa: E402
from service.errors import missing_library  # noqa: E402

if TYPE_CHECKING:
    from service.client import *  # noqa: F403
    from service.figures.catalogue import figure as figure
    from service.local import run as run
    from service.local import thresholds as thresholds

_OTHERS: Final = {
    "figure": "service.figures.catalogue", "run": "service.local", "thresholds": "service.local",
}  # fmt: skip
__all__ = [*_client.__all__, *_OTHERS]  # noqa: PLE0604


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(_OTHERS.get(name, "service.client")), name)
    except ModuleNotFoundError as error:
        if (missing := missing_library(error)) is None:
            raise
        raise ModuleNotFoundError(f"{name} {missing}", name=error.name) from error


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
