"""The HTTP API as one page of plain HTML, without scripts; the usual viewers load theirs from other hosts."""

import json
import re
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from service.api.openapi import EXAMPLES
from worker.sweep import SweepSpec

router = APIRouter(include_in_schema=False)

_PAGE: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}: HTTP API</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="static/icon.svg" type="image/svg+xml">
<link rel="stylesheet" href="static/style.css"><link rel="stylesheet" href="static/docs.css">
</head><body>
<a class="skip" href="#content">Skip to the content</a>
<header><a class="name" href="./"><img src="static/icon.svg" alt="" width="26" height="26">Bouncing spring</a>
<nav aria-label="Main"><a href="./#/">Sweeps</a><a href="./#/new">New</a><a href="./#/explore">Explore</a>
<a href="docs" aria-current="page">API</a></nav></header>
<main id="content" tabindex="-1">
<h1>HTTP API</h1><p>{summary} Machine-readable: <a href="openapi.json">/openapi.json</a>.</p>
<nav aria-label="Calls"><ul class="calls">{contents}</ul></nav>
<h2 id="specification">The specification of a sweep</h2>
<p>{about} Submit it with <a href="#{submit}">POST /v1/jobs</a>; the same sweep is always the same job.</p>
<pre tabindex="0" aria-label="Example">{example}</pre>
{specification}
{operations}
</main></body></html>
"""

#: The page's own policy: it has no scripts, and its styles are those of the page at /.
_POLICY: Final = (
    "default-src 'none'; style-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'"
)

_EXAMPLE: Final = """\
curl {address}v1/jobs -H "Content-Type: application/json" -d '{specification}'
curl {address}v1/jobs/ID
curl "{address}v1/jobs/ID/diagram?xi=0.26&amp;format=png" -o diagram.png"""


@router.get("/docs")
def docs(request: Request) -> HTMLResponse:
    """The sweep's specification with an example, and every operation, from the API document."""
    document = request.app.openapi()
    operations = [
        (method, path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]
    schemas = document["components"]["schemas"]
    content = _PAGE.format(
        title=escape(document["info"]["title"]),
        summary=escape(document["info"]["summary"]),
        contents="".join(
            f'<li><a href="#{_anchor(method, path)}">{method.upper()} {escape(path)}</a></li>'
            for method, path, _ in operations
        ),
        submit=_anchor("post", "/v1/jobs"),
        about=escape(schemas["SweepSpec"]["description"].split("\n")[0]),
        example=_EXAMPLE.format(
            address=escape(str(request.base_url)),
            specification=escape(json.dumps(EXAMPLES[SweepSpec], indent=1), quote=False),
        ),
        specification=_fields(schemas),
        operations="\n".join(_operation(*operation, schemas) for operation in operations),
    )
    return HTMLResponse(content, headers={"Content-Security-Policy": _POLICY, "Cache-Control": "no-cache"})


def _anchor(method: str, path: str) -> str:
    return re.sub("[^a-z0-9]+", "-", f"{method} {path}".lower()).strip("-")


def _fields(schemas: Mapping[str, Any]) -> str:
    """A table of the fields of the specification, then one for each object that it contains."""
    names, tables = ["SweepSpec"], []
    for name in names:
        schema = schemas[name]
        parts = re.findall(r"#/components/schemas/(\w+)", json.dumps(schema))
        names += [part for part in dict.fromkeys(parts) if part not in names]
        required = schema.get("required", [])
        rows = "".join(
            f"<tr><th scope=row>{escape(field)}</th><td>{_value(value)}</td>"
            f"<td>{'required' if field in required else _default(value)}</td></tr>"
            for field, value in schema.get("properties", {}).items()
        )
        about = _prose(schema.get("description", "").split("\n\n")[0])
        head = "" if name == "SweepSpec" else f'<h3 id="{name}">{name}</h3><p>{about}</p>'
        if rows:
            tables.append(f"{head}{_table(f'Fields of {name}', rows, ('field', 'value', 'default'))}")
    return "".join(tables)


def _value(schema: Mapping[str, Any]) -> str:
    """The values of a field, with links to objects."""
    options = schema.get("anyOf", schema.get("oneOf", [schema]))
    return " or ".join(dict.fromkeys(_option(option) for option in options))


_LIMITS: Final = {
    "minimum": "at least",
    "exclusiveMinimum": "above",
    "maximum": "at most",
    "exclusiveMaximum": "below",
}


def _option(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        name = _name(schema)
        return f'<a href="#{name}">{name}</a>'
    if "const" in schema or "enum" in schema:
        values = schema.get("enum", [schema.get("const")])
        return " or ".join(escape(json.dumps(value)) for value in values)
    if schema.get("type") == "array":
        return f"list of {_value(schema.get('items', {}))}"
    bounds = ", ".join(f"{words} {schema[key]:g}" for key, words in _LIMITS.items() if key in schema)
    return " ".join(filter(None, [escape(str(schema.get("type", "any"))), bounds]))


def _default(schema: Mapping[str, Any]) -> str:
    return escape(json.dumps(schema.get("default", schema.get("x-default"))))


def _table(label: str, rows: str, columns: tuple[str, ...] = ()) -> str:
    head = "".join(f"<th scope=col>{column}</th>" for column in columns)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}"><table>'
        f"{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>{rows}</tbody></table></div>"
    )


def _operation(method: str, path: str, operation: Mapping[str, Any], schemas: Mapping[str, Any]) -> str:
    rows = [f"<tr><th scope=row>{name}</th><td>{text}</td></tr>" for name, text in _rows(operation, schemas)]
    name = f"{method.upper()} {path}"
    return (
        f'<h2 id="{_anchor(method, path)}">{escape(name)}</h2>'
        f"<p><strong>{escape(operation['summary'])}.</strong> {_prose(operation.get('description', ''))}</p>"
        f"{_table(name, ''.join(rows))}"
    )


def _rows(operation: Mapping[str, Any], schemas: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Parameters, body and statuses, each with its text in HTML."""
    for parameter in operation.get("parameters", []):
        schema = parameter["schema"]
        options = [option for option in schema.get("anyOf", [schema]) if option.get("type") != "null"]
        value = _value({"anyOf": [schemas[_name(part)] if "$ref" in part else part for part in options]})
        default = f"default {_default(schema)}" if schema.get("default") is not None else ""
        description = _prose(parameter.get("description") or schema.get("description") or "")
        yield parameter["name"], "; ".join(filter(None, [value, default, description]))
    if "requestBody" in operation:
        ((kind, content),) = operation["requestBody"]["content"].items()
        models = content["schema"].get("oneOf", [content["schema"]])
        yield "body", f"{kind}: {' or '.join(map(_name, models))}"
    yield "status", ", ".join(sorted(operation["responses"]))


def _prose(text: str) -> str:
    """A text of the API document in HTML: only paragraphs and items end lines, and code is in backquotes."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", re.sub(r"(?<!\n)\n *(?![\n -])", " ", escape(text)))


def _name(reference: Mapping[str, Any]) -> str:
    """The name of the schema referred to; for a schema itself, its format."""
    return str(reference.get("$ref", reference.get("format")).rpartition("/")[2])
