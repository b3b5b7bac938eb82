"""The bouncing spring in one import: functions that run here, the client, and the parts of a specification.

    from bouncing_spring import Client, run, thresholds

Has all names of `service.client`, and the classes of a sweep. Importing this module loads no numerical
library.
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
    from worker.spec.axes import Range as Range
    from worker.spec.contact_models import Auto as Auto
    from worker.spec.contact_models import Ball as Ball
    from worker.spec.contact_models import Rigid as Rigid
    from worker.spec.contact_models import Soft as Soft
    from worker.spec.contact_models import Stepped as Stepped
    from worker.spec.refine import Refine as Refine
    from worker.sweep import SweepSpec as SweepSpec
    from worker.sweep.protocols import OnCycle as OnCycle
    from worker.sweep.protocols import Ramp as Ramp
    from worker.sweep.protocols import Rest as Rest

#: The modules of names that load numerical libraries.
_OTHERS: Final = {
    "figure": "service.figures.catalogue", "run": "service.local", "thresholds": "service.local",
    "Range": "worker.spec.axes", "Refine": "worker.spec.refine", "SweepSpec": "worker.sweep",
    **dict.fromkeys(("Auto", "Ball", "Rigid", "Soft", "Stepped"), "worker.spec.contact_models"),
    **dict.fromkeys(("OnCycle", "Ramp", "Rest"), "worker.sweep.protocols"),
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
