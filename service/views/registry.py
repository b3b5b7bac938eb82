"""All results of the service. HTTP, client, command line and documents loop over VIEWS and SPRINGS.

A new result is a module of this package and a row here.
"""

from collections.abc import Sequence
from functools import partial
from math import inf
from typing import Any, Final

from xarray import Dataset

from service.errors import InvalidRequest, TooLarge
from service.formats import PICTURES
from service.jobs.prepare import PreparedJob
from service.ledger.model import JobRecord, JobState
from service.software import software
from service.views import (
    audit,
    basins,
    diagram,
    difference,
    encode,
    modes,
    multistability,
    orbits,
    threshold,
    trajectory,
)
from service.views.selection import MAX_READ, Stored
from service.views.springs import curves
from service.views.springs import orbits as spring_orbits
from service.views.springs import threshold as spring_threshold
from service.views.view import Estimate, Query, View

#: The results of a job, by name.
VIEWS: Final[dict[str, View]] = {
    view.name: view
    for view in (
        diagram.VIEW, modes.VIEW, difference.VIEW, threshold.VIEW, orbits.VIEW, basins.VIEW,
        multistability.VIEW, trajectory.VIEW, audit.VIEW,
    )
}  # fmt: skip

#: The results of springs without a sweep.
SPRINGS: Final[dict[str, View]] = {
    view.name: view
    for view in (spring_threshold.VIEW, spring_threshold.GRID, spring_orbits.VIEW, curves.VIEW)
}


def stored(job: JobRecord, prepared: PreparedJob) -> Stored[Any]:
    """The specification of a job of any kind, and the address of its results."""
    done = job.state is JobState.DONE
    return Stored(
        prepared.spec.model_copy(update={"name": job.name}), prepared.store_url, done, job.kernel_version,
        job.repairing, job.id, job.chunks_done, prepared.forms,
        prepared.submitted.model_copy(update={"name": job.name}),
    )  # fmt: skip


def admit(
    view: View, spec: Any, query: Query, format: str, max_points: int, max_seconds: float = inf
) -> tuple[Query, Estimate]:
    """Check a query; returns it with its estimate. A picture's query is thinned to cells that can be read.

    Raises InvalidRequest for a study without this result, NotInstalled for Parquet without its library,
    TooLarge, which names the `every` that fits, and as the view's `estimate`.
    """
    if view.study is not None and not isinstance(spec, view.study):
        names = [name for name, other in VIEWS.items() if other.study and isinstance(spec, other.study)]
        others = f"; it has {', '.join(names)}" if names else ""
        kind = spec.protocol.kind
        raise InvalidRequest(f"this job has no {view.name}: its protocol is {kind}{others}")
    encode.check_format(format)
    estimate = view.estimate(spec, query)
    if estimate.seconds > max_seconds:
        raise TooLarge(
            f"the answer takes about {estimate.seconds:.3g} s to compute; the limit is {max_seconds:g} s"
        )
    limit = MAX_READ if format in PICTURES else max_points
    limit = limit if estimate.most is None else min(limit, estimate.most)
    if estimate.points <= limit:
        return query, estimate
    every = estimate.fitting(limit)
    if every is not None and format in PICTURES:
        query = query.model_copy(update={"every": every})
        return query, view.estimate(spec, query)
    sizes = " × ".join(f"{name} {n:,}" for name, n in estimate.sizes.items())
    hint = "ask for less" if view.study is None else "open the store itself, which has no such limit"
    if every is not None:
        hint = f"every={every} fits; request a picture for all of them, or {hint}"
    raise TooLarge(
        f"the answer would hold up to {estimate.points:,} points ({sizes}); the limit is {limit:,}: {hint}"
    )


def answer(
    name: str, study: Stored[Any] | None, query: Query, format: str, parts: Sequence[Any] = ()
) -> tuple[bytes, bool]:
    """Compute a result of a study or a spring: its bytes, and whether it is complete.

    Arguments and result can be pickled. Raises as `View.compute`.
    """
    view = SPRINGS[name] if study is None else VIEWS[name]
    result = view.compute(study, query, *parts)
    return encoded(view, study, result, format), bool(result.attrs["complete"])


def motion(spec: trajectory.TrajectorySpec, format: str) -> bytes:
    """Compute the motion of one cell without a job: its bytes. Raises as `trajectory.motion`."""
    return encoded(trajectory.VIEW, None, trajectory.motion(spec), format)


def encoded(view: View, study: Stored[Any] | None, result: Dataset, format: str) -> bytes:
    """The bytes of a result in a format."""
    about = {"release": software().release} if study is None else study.attributes
    result.attrs = {"Conventions": "CF-1.11", "title": view.summary, **about, **result.attrs}
    if view.draw is not None and format in PICTURES:
        origin = about if study is None else study.origin
        return encode.picture(view.size, partial(view.draw, result), format, origin)
    if format in encode.DATASETS:
        return encode.DATASETS[format](result)
    return encode.TABLES[format](result, view.finer_rows if view.finer_rows in result else view.rows)


def warm() -> None:
    """Import Dask, which xarray does with its first Dataset; this module has imported the rest."""
    Dataset({"x": ("x", [0])})


def warm_pictures() -> None:
    """Import what `warm` does, and Matplotlib, as the first picture does."""
    warm()
    encode.picture((1.0, 1.0), lambda _: None, "png", {})
