"""The reference of the HTTP API, from its contract openapi/openapi.json."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docs.site.markdown import code, row

CONTRACT = Path(__file__).resolve().parents[2] / "openapi" / "openapi.json"

INTRODUCTION = """\
# HTTP reference

Every address with its parameters, bodies and answers, from [openapi.json](../openapi.json), the
contract that programs can read. [The API](../api.md) is the page to begin with.
"""

Schema = dict[str, Any]


def page() -> str:
    """Operations by resource, then the documents that they take and give."""
    contract = json.loads(CONTRACT.read_text(encoding="utf-8"))
    resources: dict[str, list[str]] = {}
    for path, item in contract["paths"].items():
        for method, operation in item.items():
            lines = resources.setdefault(operation["tags"][0], [])
            lines += _operation(method, path, operation)
    text = [INTRODUCTION]
    for resource, lines in resources.items():
        text += [f"## {resource.capitalize()}", "", *lines]
    text += ["## Documents", ""]
    for name, schema in contract["components"]["schemas"].items():
        text += _document(name, schema)
    return "\n".join(text)


def _operation(method: str, path: str, operation: Schema) -> Iterator[str]:
    yield from (f"### {operation['summary']}", "", f"`{method.upper()} {path}`", "")
    yield from (operation["description"], "")
    if parameters := operation.get("parameters"):
        yield from (row("parameter", "in", "type", "meaning"), row(*["---"] * 4))
        for each in parameters:
            mark = ", required" if each.get("required") and each["in"] != "path" else ""
            meaning = each.get("description", "") + _default(each["schema"])
            yield row(code(each["name"]), each["in"] + mark, _type(each["schema"]), meaning)
        yield ""
    for kind, body in operation.get("requestBody", {}).get("content", {}).items():
        yield from (f"Takes {code(kind)}: {_type(body.get('schema', {}))}.", "")
        for example in body.get("examples", {}).values():
            yield from ("```json", json.dumps(example["value"], indent=2), "```", "")
    yield from (row("status", "answer"), row("---", "---"))
    for status, answer in operation["responses"].items():
        if "$ref" not in answer:
            yield row(status, f"{answer['description'].rstrip('.')}{_content(answer)}")
    errors = [status for status, answer in operation["responses"].items() if "$ref" in answer]
    yield from (row(", ".join(errors), "[`ProblemDocument`](#problemdocument)"), "")


def _content(answer: Schema) -> str:
    """What an answer holds: documents by their names, files by their kinds."""
    held = [
        _type(body["schema"]) if "$ref" in body.get("schema", {}) else code(kind)
        for kind, body in answer.get("content", {}).items()
    ]
    return ": " + ", ".join(dict.fromkeys(held)) if held else ""


def _document(name: str, schema: Schema) -> Iterator[str]:
    yield from (f"### {name}", "", schema.get("description", ""), "")
    if "enum" in schema:
        yield from (f"One of {_type(schema)}.", "")
    if properties := schema.get("properties"):
        required = schema.get("required", ())
        yield from (row("field", "type", "meaning"), row(*["---"] * 3))
        for field, each in properties.items():
            is_needed = field in required and schema.get("additionalProperties") is False
            mark = " Required." if is_needed else _default(each)
            yield row(code(field), _type(each), (each.get("description", "") + mark).strip())
        yield ""


def _default(schema: Schema) -> str:
    """The default in words; none where it is nothing."""
    value = schema.get("default")
    return f" Default: {code(json.dumps(value))}." if value not in (None, "", [], {}) else ""


def _type(schema: Schema) -> str:
    """A schema in a few words, with links to documents."""
    if reference := schema.get("$ref"):
        name = reference.rpartition("/")[2]
        return f"[`{name}`](#{name.lower()})"
    if choices := schema.get("enum", [schema["const"]] if "const" in schema else []):
        return ", ".join(code(str(each)) for each in choices)
    if options := schema.get("anyOf", schema.get("oneOf")):
        return " or ".join(_type(each) for each in options if each.get("type") != "null")
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return f"{schema.get('format') or schema.get('type', 'anything')}{_range(schema)}"


def _range(schema: Schema) -> str:
    """The bounds of a number; nothing for anything else."""
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    bounds = [f"{sign} {schema[name]}" for name, sign in signs.items() if name in schema]
    return f" {', '.join(bounds)}" if bounds else ""
