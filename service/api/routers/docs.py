"""The calls on one page of plain HTML, whole: the usual viewers fetch their scripts from elsewhere."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

router = APIRouter(include_in_schema=False)

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}: the calls</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root {{ color-scheme: light dark }}
body {{ font: 1rem/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }}
h2 {{ font: 600 1.05rem ui-monospace, monospace; margin-top: 2rem }}
td, th {{ text-align: left; vertical-align: top; padding: .1rem 1rem .1rem 0 }}
</style></head><body>
<h1>{title}</h1><p>{summary} Machines read <a href="/openapi.json">/openapi.json</a>.</p>
{calls}
</body></html>
"""


@router.get("/docs")
def docs(request: Request) -> HTMLResponse:
    """The calls, their parameters and answers."""
    document = request.app.openapi()
    calls = "\n".join(
        _call(method, path, call)
        for path, methods in document["paths"].items()
        for method, call in methods.items()
    )
    about = document["info"]
    page = _PAGE.format(title=escape(about["title"]), summary=escape(about["summary"]), calls=calls)
    return HTMLResponse(page)


def _call(method: str, path: str, call: Mapping[str, Any]) -> str:
    rows = "".join(_rows(call))
    return (
        f"<h2>{method.upper()} {escape(path)}</h2>"
        f"<p>{escape(call.get('description', ''))}</p><table>{rows}</table>"
    )


def _rows(call: Mapping[str, Any]) -> Iterator[str]:
    for parameter in call.get("parameters", []):
        schema = parameter["schema"]
        what = parameter.get("description") or schema.get("description") or ""
        default = f"default {schema['default']}" if schema.get("default") is not None else ""
        yield _row(parameter["name"], "; ".join(filter(None, [_kind(schema), default, what])))
    if "requestBody" in call:
        (kind,) = call["requestBody"]["content"].values()
        yield _row("body", f"application/json: {kind['schema'].get('$ref', '').rpartition('/')[2]}")
    yield _row("answers", ", ".join(sorted(call["responses"])))


def _row(name: str, text: str) -> str:
    return f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>"


def _kind(schema: Mapping[str, Any]) -> str:
    """A parameter's type in a word, or the words it may be."""
    options = [one for one in schema.get("anyOf", [schema]) if one.get("type") != "null"]
    first = options[0] if options else {}
    return " | ".join(map(str, first["enum"])) if "enum" in first else str(first.get("type", ""))
