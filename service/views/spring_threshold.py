"""The thresholds of one spring in closed form, of the rigid contact without restitution."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, Final

import numpy as np
import xarray
from pydantic import Field

from kernel.branches.descent import lifetime
from kernel.branches.thresholds import Thresholds
from service.views.variables import ENERGY, coordinate, row, variable
from service.views.view import AT_ONCE_SECONDS, Call, Estimate, Number, Omega, Query, View, Xi
from worker.analysis.prediction import predict, prediction_seconds

#: The contact of the closed form.
CONTACT: Final = "rigid, restitution 0"

#: Springs whose thresholds are kept: the least recently used one makes room.
KEPT: Final = 4096

_ROWS: Final = (
    row("threshold", (), "<f8", "Γ at which rest ends, Eq. 25", comment="NaN: at none"),
    row("jump", (), "<f8", "Γ of the fold at which flights leap on the way up"),
    row("down", (), "<f8", "lowest Γ at which anything bounces for ever", comment="NaN: not decided"),
    row("cause", (), "U", "what ends bouncing at down"),
    row("reason", (), "U", "why down is not decided"),
    row("lifetime", (), "<f8", "life of bouncing at Γ = down - delta", "plate periods"),
    row("delta", (), "<f8", "Γ below down"),
    *ENERGY,
)


class ThresholdQuery(Query):
    """A spring, and how far below the fold it bounces."""

    omega: Omega
    xi: Xi
    delta: Annotated[
        Number, Field(ge=1e-15, le=0.1, description="Γ below `down` for which the lifetime is told")
    ] = 1e-6


@lru_cache(KEPT)
def predicted(omega: float, xi: float) -> Thresholds:
    """The thresholds of one spring; `unresolved` or `not searched` where the rule does not decide."""
    return predict(omega, xi)


def compute(study: None, query: ThresholdQuery, *computed: Thresholds) -> xarray.Dataset:
    """Where one spring begins and ceases to bounce.

    In closed form, of the rigid contact without restitution. `down` is the lowest Γ at which anything bounces
    for ever, by a rule that no search contradicts at its damping: `cause` is `not searched` below that, and
    `unresolved` where the rule does not decide. A slow descent ends there or earlier, where the cycle that it
    is on ends. Below a fold bouncing lives for `lifetime`; the energy balance is that of the cycle at the
    fold. A worker computes what takes longer than a second.
    """
    found = computed[0] if computed else predicted(query.omega, query.xi)
    data: dict[str, Any] = {
        "threshold": found.gamma_th if np.isfinite(found.gamma_th) else np.nan,
        "jump": found.jump, "down": found.down, "cause": found.cause, "reason": found.reason,
    }  # fmt: skip
    if found.fold is not None:
        data |= {"lifetime": lifetime(found.fold, query.delta), "delta": query.delta}
        data |= {name: values[0] for name, values in found.fold.energy._asdict().items()}
    return xarray.Dataset(
        {row.name: variable((), data.get(row.name, np.nan), row) for row in _ROWS},
        {name: coordinate(name, getattr(query, name)) for name in ("omega", "xi")},
        {"model": CONTACT, "complete": True},
    )


def estimate(spec: None, query: ThresholdQuery) -> Estimate:
    """A few numbers."""
    return Estimate({})


def parts(study: None, query: ThresholdQuery) -> Sequence[Call]:
    """The prediction, if it takes long."""
    if prediction_seconds(query.omega, query.xi) <= AT_ONCE_SECONDS:
        return ()
    return [(predict, query.omega, query.xi)]


VIEW: Final = View(
    "threshold", "Thresholds of a spring", None, ThresholdQuery, compute, estimate, variables=_ROWS,
    parts=parts,
)  # fmt: skip
