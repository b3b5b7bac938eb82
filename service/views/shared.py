"""Writes a sweep as one HTML file: the page with its answers, which opens without a service or a network.

The page's modules are `data:` addresses in an import map, which browsers also accept in a file.
"""

import gzip
import html
import json
import posixpath
import re
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, Final

from service.software import software
from service.views import diagram, modes, threshold
from service.views.registry import encoded
from service.views.selection import Stored
from service.views.view import Query, View
from worker.study.layout import REFERENCE
from worker.sweep import AXES, SweepSpec

FILES: Final = Path(__file__).parents[1] / "static"
#: Limit on the bytes of compressed flights; above, every second line is left out, repeatedly.
MOST_BYTES: Final = 6_000_000
#: Limits on lines, on flights of a line and of all lines, and on cells of a map; above, every n-th is taken.
MOST_LINES, MOST_FLIGHTS, MOST_IN_ALL, MOST_CELLS = 400, 60_000, 4_000_000, 250_000

_IMPORT: Final = re.compile(r'(from |import |import\()"(\.{1,2}/[^"]+)"(?: with \{[^}]*\})?')
_CHECKSUM: Final = re.compile('data-sha256="([0-9a-f]+)"')
_OUTSIDE: Final = re.compile(r"\s*<(?:link|script)[^>]*>(?:</script>)?")


def page(study: Stored[SweepSpec], attributes: Mapping[str, Any], numbers: str = "") -> str:
    """The file of a sweep.

    attributes: as `exports.attributes_of`. numbers: the whole store, as `sharing.packed`; empty if it is too
    large. Without scripts the file shows the diagram of the middle line and the attributes.
    """
    lines, left_out = _lines(study)
    spec = study.spec
    cells = prod(spec.shape)
    progress = {
        "cells_done": cells, "cells_total": cells, "chunks_done": 1, "chunks_total": 1, "percent": 100,
        "eta_seconds": None, "cells_settling": 0, "cells_computed": None, "cells_needed": None,
    }  # fmt: skip
    job = {
        "id": study.job, "name": spec.name, "state": "done", "spec": json.loads(attributes["spec"]),
        "error": None, "kernel_version": study.kernel_version, "notice": None,
        "choice": json.loads(attributes.get("choice", "null")), "created": None, "progress": progress,
    }  # fmt: skip
    answers = {"diagram": lines, "modes": _maps(study), "threshold": _thresholds(study)}
    missing = "" if study.complete else "The sweep was not complete: cells are missing"
    shows = "" if numbers or missing else "It shows the sweep; its numbers are too many to be imported"
    note = ". ".join(filter(None, [missing, study.audit, left_out, shows]))
    about = {
        "Note": note, "Core-seconds": attributes.get("core_seconds"), "Software": attributes.get("software"),
        "History": attributes.get("history"),
        "Checksum of its numbers": "".join(_CHECKSUM.findall(numbers)),
        "How to cite": f"bouncing-spring {software().release}, and {REFERENCE}",
    }  # fmt: skip
    shown = {"job": job, "answers": answers, "note": note, "about": about}
    shared = json.dumps(shown).replace("<", "\\u003c")  # no name may begin a tag inside the script
    imports = json.dumps({"imports": dict(_modules())})
    head = "".join(f"<style>{(FILES / name).read_text()}</style>" for name in ("style.css", "views.css"))
    scripts = (
        f'{numbers}<script type="application/json" id="shared">{shared}</script>'
        f'<script type="importmap">{imports}</script>'
        '<script type="module">import "bounce/js/main.js";</script>'
    )
    text = _OUTSIDE.sub("", (FILES / "index.html").read_text())
    text = text.replace("static/icon.svg", _address((FILES / "icon.svg").read_bytes(), "image/svg+xml"))
    text = text.replace("</head>", f"{head}</head>")
    text = re.sub("<noscript>.*?</noscript>", lambda _: _still(study, attributes, note), text)
    return text.replace("</body>", f"{scripts}</body>")


def _modules() -> Iterator[tuple[str, str]]:
    """The page's modules: names in the import map, and addresses of their text, which imports these names."""
    for path in sorted((FILES / "js").rglob("*.js")):
        name = path.relative_to(FILES).as_posix()

        def renamed(match: re.Match[str], folder: str = posixpath.dirname(name)) -> str:
            return f'{match[1]}"bounce/{posixpath.normpath(posixpath.join(folder, match[2]))}"'

        text = _IMPORT.sub(renamed, path.read_text())
        yield f"bounce/{name}", _address(text.encode(), "text/javascript")
    palette = f"export default {(FILES / 'palette.json').read_text()}"
    yield "bounce/palette.json", _address(palette.encode(), "text/javascript")


def _address(content: bytes, media_type: str) -> str:
    return f"data:{media_type};base64,{b64encode(content).decode()}"


def _answer(view: View, study: Stored[SweepSpec], query: Query, **about: Any) -> dict[str, Any]:
    """An answer as the page reads it, compressed, with the parameters that identify it."""
    content = encoded(view, study, view.compute(study, query), "bin")
    return {**about, "data": b64encode(gzip.compress(content, 6, mtime=0)).decode()}


def _lines(study: Stored[SweepSpec]) -> tuple[list[dict[str, Any]], str]:
    """The diagrams along the longest axis, and a sentence on omitted lines and cells."""
    spec = study.spec
    along, every, places = _places(spec)
    flights = spec.shape[0] * spec.keep * -(-len(spec.axis_values(along)) // every)
    step = -(-len(places) // min(MOST_LINES, max(MOST_IN_ALL // flights, 1)))
    places = places[::step]

    def line_of(i: int) -> dict[str, Any]:
        query = diagram.DiagramQuery.model_validate({"along": along, "every": every, **places[i]})
        return _answer(diagram.VIEW, study, query, **places[i])

    lines, apart = _fitting(len(places), line_of)
    step *= apart
    thinned = [f"1 line in {step}" if step > 1 else "", f"1 cell in {every} of a line" if every > 1 else ""]
    omitted = " and ".join(filter(None, thinned))
    return lines, f"Diagrams: {omitted}" if omitted else ""


def _fitting(count: int, line_of: Callable[[int], dict[str, Any]]) -> tuple[list[dict[str, Any]], int]:
    """As many of `count` lines as MOST_BYTES allow, and their distance, a power of two.

    From coarse to fine, as few lines as possible are computed in vain.
    """
    apart = 1 << (count - 1).bit_length()
    lines = {0: line_of(0)}
    size = len(lines[0]["data"])
    while apart > 1:
        finer = {}
        for i in range(apart // 2, count, apart):
            finer[i] = line_of(i)
            size += len(finer[i]["data"])
            if size > MOST_BYTES:
                return [lines[i] for i in sorted(lines)], apart
        lines, apart = lines | finer, apart // 2
    return [lines[i] for i in sorted(lines)], apart


def _places(spec: SweepSpec) -> tuple[str, int, list[dict[str, float]]]:
    """The longest axis, n to show every n-th of its cells, and the places of its lines on the other axes."""
    along = max(("gamma", "omega", "xi"), key=lambda axis: len(spec.axis_values(axis)))
    every = -(-len(spec.axis_values(along)) * spec.keep // MOST_FLIGHTS)
    others = [axis for axis in AXES if axis != along]
    places = product(*(spec.axis_values(axis).tolist() for axis in others))
    return along, every, [dict(zip(others, place, strict=True)) for place in places]


def _maps(study: Stored[SweepSpec]) -> list[dict[str, Any]]:
    """The mode maps of every xi and direction; none if the sweep has no plane."""
    spec = study.spec
    directions, _, omega, gamma = spec.shape
    if min(omega, gamma) < 2:
        return []
    every = max(1, int((omega * gamma / MOST_CELLS) ** 0.5 + 0.999))
    maps = []
    for xi, direction in product(spec.axis_values("xi")[:MOST_LINES].tolist(), spec.directions):
        query = modes.ModesQuery(xi=xi, direction=direction, every=every, hysteresis=directions > 1)
        maps.append(_answer(modes.VIEW, study, query, xi=xi, direction=direction))
    return maps


def _thresholds(study: Stored[SweepSpec]) -> list[dict[str, Any]]:
    """The thresholds of every xi on the grid; none for a ramp along another axis than gamma."""
    if study.spec.ramp_axis not in (None, "gamma"):
        return []
    values = study.spec.axis_values("xi")[:MOST_LINES].tolist()
    queries = [(xi, threshold.ThresholdQuery(xi=xi, predict="none")) for xi in values]
    return [_answer(threshold.VIEW, study, query, xi=xi) for xi, query in queries]


def _still(study: Stored[SweepSpec], attributes: Mapping[str, Any], note: str) -> str:
    """The page for readers without scripts: a picture and a table."""
    along, every, places = _places(study.spec)
    query = diagram.DiagramQuery.model_validate({"along": along, "every": every, **places[len(places) // 2]})
    picture = encoded(diagram.VIEW, study, diagram.compute(study, query), "png")
    rows = {"note": note, **attributes}
    cells = "".join(
        f"<tr><th scope=row>{html.escape(name)}</th><td>{html.escape(str(value))}</td></tr>"
        for name, value in rows.items() if value
    )  # fmt: skip
    source = _address(picture, "image/png")
    name = html.escape(study.spec.name or "A sweep of the bouncing spring")
    return (
        f"<h1>{name}</h1><img alt='Bifurcation diagram' style='max-width: 100%' src='{source}'>"
        f"<table>{cells}</table>"
    )
