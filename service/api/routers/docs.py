"""The HTTP API as one page of plain HTML; the usual viewers load their scripts from other hosts."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

router = APIRouter(include_in_schema=False)

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}: HTTP API</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root {{ color-scheme: light dark }}
body {{ font: 1rem/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }}
h2 {{ font: 600 1.05rem ui-monospace, monospace; margin-top: 2rem }}
td, th {{ text-align: left; vertical-align: top; padding: .1rem 1rem .1rem 0 }}
</style></head><body>
<h1>{title}</h1><p>{summary} Machine-readable: <a href="/openapi.json">/openapi.json</a>.</p>
{operations}
</body></html>
"""


@router.get("/docs")
def docs(request: Request) -> HTMLResponse:
    """Every operation with its parameters and responses, from the API document."""
    document = request.app.openapi()
    operations = "\n".join(
        _operation(method, path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    )
    info = document["info"]
    title, summary = escape(info["title"]), escape(info["summary"])
    return HTMLResponse(_PAGE.format(title=title, summary=summary, operations=operations))


def _operation(method: str, path: str, operation: Mapping[str, Any]) -> str:
    rows = "".join(_rows(operation))
    return (
        f"<h2>{method.upper()} {escape(path)}</h2><p><strong>{escape(operation['summary'])}.</strong> "
        f"{escape(operation.get('description', ''))}</p><table>{rows}</table>"
    )


def _rows(operation: Mapping[str, Any]) -> Iterator[str]:
    for parameter in operation.get("parameters", []):
        schema = parameter["schema"]
        description = parameter.get("description") or schema.get("description") or ""
        default = f"default {schema['default']}" if schema.get("default") is not None else ""
        yield _row(parameter["name"], "; ".join(filter(None, [_type(schema), default, description])))
    if "requestBody" in operation:
        (content,) = operation["requestBody"]["content"].values()
        yield _row("body", f"application/json: {content['schema'].get('$ref', '').rpartition('/')[2]}")
    yield _row("status", ", ".join(sorted(operation["responses"])))


def _row(name: str, text: str) -> str:
    return f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>"


def _type(schema: Mapping[str, Any]) -> str:
    """A parameter's type, or the values it may have."""
    options = [option for option in schema.get("anyOf", [schema]) if option.get("type") != "null"]
    first = options[0] if options else {}
    return " | ".join(map(str, first["enum"])) if "enum" in first else str(first.get("type", ""))
