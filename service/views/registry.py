"""Every result of the service. HTTP, client, command line and documents loop over VIEWS.

A new result is a module of this package and a row here.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from service.errors import InvalidRequest, TooLarge
from service.formats import PICTURES
from service.results.selection import MAX_READ, Stored
from service.software import software
from service.views import basins, curves, diagram, encode, modes, orbits, words
from service.views.view import Estimate, Query, View

#: The results of a job, by name.
VIEWS: Final[dict[str, View]] = {
    view.name: view for view in (diagram.VIEW, modes.VIEW, basins.VIEW, words.VIEW)
}

#: The results of a spring alone, in closed form.
SPRINGS: Final[dict[str, View]] = {view.name: view for view in (orbits.VIEW, curves.VIEW)}


def admit(view: View, spec: Any, query: Query, format: str, max_points: int) -> tuple[Query, Estimate]:
    """The query and its estimate; a picture is thinned to what can be read.

    Raises InvalidRequest for a study without this result, TooLarge naming the `every` that fits.
    """
    if view.study is not None and not isinstance(spec, view.study):
        names = [name for name, other in VIEWS.items() if other.study and isinstance(spec, other.study)]
        there = f"; it has {', '.join(names)}" if names else ""
        kind = spec.protocol.kind
        raise InvalidRequest.of("job_id", f"has no {view.name}: the protocol of this job is {kind}{there}")
    estimate = view.estimate(spec, query)
    limit = MAX_READ if format in PICTURES else max_points
    limit = limit if estimate.most is None else min(limit, estimate.most)
    if estimate.points <= limit:
        return query, estimate
    every = estimate.fitting(limit)
    if every is not None and format in PICTURES:
        query = query.model_copy(update={"every": every})
        return query, view.estimate(spec, query)
    sizes = " × ".join(f"{name} {n:,}" for name, n in estimate.sizes.items())
    hint = "open the store itself, which has no such limit"
    if every is not None:
        hint = f"every={every} fits; request a picture for all of them, or {hint}"
    raise TooLarge(
        f"the answer would hold up to {estimate.points:,} points ({sizes}); the limit is {limit:,}: {hint}"
    )


def answer(
    name: str, study: Stored[Any] | None, fields: Mapping[str, Any], format: str, parts: Sequence[Any] = ()
) -> tuple[bytes, bool]:
    """The bytes of a result of a study, or of a spring, and whether it is complete.

    Arguments and result can be pickled.

    Raises as `View.compute`.
    """
    view = SPRINGS[name] if study is None else VIEWS[name]
    found = view.compute(study, view.query(**fields), *parts)
    about = {"release": software().release} if study is None else study.attributes
    found.attrs = {"Conventions": "CF-1.11", "title": view.summary, **about, **found.attrs}
    complete = bool(found.attrs["complete"])
    if format in PICTURES:
        origin = about if study is None else study.origin
        return encode.picture(found, view.draw, view.size, format, origin), complete
    return encode.ENCODERS[format](found, view.rows), complete
