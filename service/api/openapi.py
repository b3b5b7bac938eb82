"""The API document: what FastAPI derives from the endpoints, with bodies, authentication and examples.

It is OpenAPI 3.1 in the parts that generators of clients understand: without keywords of a later version, and
with defaults that are objects in the description.
"""

import json
from collections.abc import Callable
from functools import cache, partial
from threading import Lock
from typing import Any, Final

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from service.api.middleware import OPEN_PATHS
from service.api.schemas import NewName, ProblemDocument
from service.views.trajectory import TrajectorySpec
from worker.basins.specification import BasinSpec, MultistabilitySpec
from worker.orbits.specification import OrbitsSpec
from worker.sweep import SweepSpec

#: The tags of the routers.
_TAGS: Final = {
    "jobs": "Submit, show, list, change and follow sweeps and other studies.",
    "results": "Diagrams, thresholds, maps, basins and files of what is computed.",
    "model": "Thresholds, cycles and motions of springs without a sweep.",
    "service": "Whether the service lives, accepts jobs, and what it does.",
    "page": "What the page in the browser reads; it may change with the page.",
}

_TOKEN: Final = {
    "type": "http",
    "scheme": "bearer",
    "description": "Required by a service that has tokens (`bounce serve --token`).",
}

#: Models of bodies that FastAPI does not parse itself, each with a valid example.
EXAMPLES: Final[dict[type[BaseModel], dict[str, Any]]] = {
    SweepSpec: {
        "name": "up and down",
        "gamma": {"start": 1.0, "stop": 5.0, "num": 201},
        "omega": 0.5,
        "xi": [0.1, 0.26],
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"},
        "model": {"kind": "rigid"},
    },
    OrbitsSpec: {"protocol": {"kind": "orbits"}, "omega": [0.5, 0.6], "xi": 0.26},
    BasinSpec: {
        "gamma": 3.6,
        "omega": 0.5,
        "xi": 0.26,
        "protocol": {"kind": "basin", "rows": 64, "columns": 64},
        "model": {"kind": "rigid"},
    },
    MultistabilitySpec: {
        "gamma": {"start": 0.9, "stop": 6.0, "num": 40},
        "omega": [0.5, 0.6],
        "xi": 0.26,
        "protocol": {"kind": "multistability"},
        "model": {"kind": "rigid"},
    },
    NewName: {"name": "up and down, again"},
    TrajectorySpec: {"gamma": 1.2, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "periods": 2},
}


def kept_document(app: FastAPI, *, needs_token: bool) -> Callable[[], dict[str, Any]]:
    """The API document, made by the first of several threads that ask.

    A first request with a query meanwhile may replace the fields that FastAPI keeps of it, by whose identity
    the document finds them: then it is made again.
    """
    make, lock = cache(partial(document, app, needs_token=needs_token)), Lock()

    def made_once() -> dict[str, Any]:
        with lock:
            try:
                return make()
            except KeyError:
                return make()

    return made_once


def document(app: FastAPI, *, needs_token: bool) -> dict[str, Any]:
    """The API document of an application whose endpoints need a token, or none."""
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        routes=app.routes,
        tags=[{"name": name, "description": text} for name, text in _TAGS.items()],
    )
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    models: list[type[BaseModel]] = [*EXAMPLES, ProblemDocument]
    for model in models:
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= schema.pop("$defs", {}) | {model.__name__: schema}
    for model, example in EXAMPLES.items():
        schemas[model.__name__]["examples"] = [example]
    components["securitySchemes"] = {"token": _TOKEN}
    if needs_token:
        document["security"] = [{"token": []}]
    for path, operations in document["paths"].items():
        for operation in operations.values():
            if path in OPEN_PATHS:
                operation["security"] = []
    mended: dict[str, Any] = json.loads(json.dumps(document), object_hook=_mended)
    return mended


def _mended(part: dict[str, Any]) -> dict[str, Any]:
    """An object of the document in terms of OpenAPI 3.1.

    A default that is an object moves to the description: generators of clients reject the field. The page's
    form reads it from `x-default`, an extension that they ignore.
    """
    if part.pop("itemSchema", None) is not None:
        part["schema"] = {"description": "server-sent events"}
    if isinstance(part.get("default"), dict) and ("oneOf" in part or "$ref" in part):
        default = part["x-default"] = part.pop("default")
        fields = {name: value for name, value in default.items() if value is not None}
        part["description"] = f"{part.get('description', '')} Default: {json.dumps(fields)}.".strip()
    return part
