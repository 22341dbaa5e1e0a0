"""The OpenAPI contract: what FastAPI finds, and what only we know."""

from __future__ import annotations

import json
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from chamfer_morph.schemas import (
    ExportRequest,
    JobRequest,
    KeyRequest,
    ProblemDocument,
    SweepRequest,
    ids,
)
from chamfer_morph.server.http.problems import MEDIA_TYPE, PROBLEM_TYPES
from morph_engine import methods, presets
from morph_engine.geometry import shapes
from morph_engine.geometry.shapes import TEXT_LIMIT, TEXT_PREFIX

EXTRA_MODELS: tuple[type[BaseModel], ...] = (
    ExportRequest,
    JobRequest,
    KeyRequest,
    ProblemDocument,
    SweepRequest,
)

BODY_ERRORS = (400, 408, 413, 415, 422, 429)
OPEN = ("livez", "readyz", "metrics")

JOB_ID = {"type": "string", "pattern": f"^{ids.PATTERN}$"}
PATH_SCHEMAS: dict[str, dict[str, Any]] = {
    "job_id": JOB_ID,
    "sweep_id": JOB_ID,
    "export_id": JOB_ID,
    "mesh_id": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
    "worker_id": {"type": "string", "pattern": "^[A-Za-z0-9.-]+$"},
    "name": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"},
    "shape": {"type": "string", "minLength": 1, "maxLength": 64},
    "field": {"type": "string", "pattern": "^[a-z_]{1,40}$"},
}

CONFLICTS = {
    "deleteMesh", "getResult", "deleteJob", "cancelJob", "resumeJob", "retryJob", "submitJob",
    "submitSweep", "makeKey", "revokeKey", "uploadMesh", "exportJob", "getExportFile",
}  # fmt: skip
LIMITED: dict[str, tuple[int, ...]] = {
    "getSurface": (413,),
    "resumeJob": (413, 429),
    "retryJob": (413, 429),
    "getEvents": (429,),
}
RANGES = {"getExportFile", "getResult", "getMeshFile", "getLog"}
HEADERS: dict[str, dict[str, Any]] = {
    "Location": {"schema": {"type": "string"}, "description": "Where it is from now on."},
    "Retry-After": {"schema": {"type": "integer"}, "description": "When to look next [s]."},
}
CREATES = {"uploadMesh": ("Location",), "makeKey": ("Location",)} | dict.fromkeys(
    ("submitJob", "submitSweep", "exportJob"), ("Location", "Retry-After")
)

MADE_BY = {
    "mesh_id": "uploadMesh", "job_id": "submitJob", "sweep_id": "submitSweep",
    "export_id": "exportJob",
}  # fmt: skip
"""The operation that makes the thing of an id."""


def install(app: FastAPI) -> None:
    """Let an application describe itself by `document`."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def text(app: FastAPI) -> str:
    """The contract as it is committed in openapi/openapi.json."""
    return json.dumps(app.openapi(), indent=2, ensure_ascii=False) + "\n"


def document(app: FastAPI) -> dict[str, Any]:
    """The contract of an application."""
    found = get_openapi(
        title=app.title,
        version=app.version,
        openapi_version="3.1.0",
        summary=app.summary,
        description=app.description,
        routes=app.routes,
        license_info=app.license_info,
    )
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    _, extra = models_json_schema(
        [(model, "validation") for model in EXTRA_MODELS],
        ref_template="#/components/schemas/{model}",
    )
    schemas.update(extra["$defs"])
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    _name_choices(schemas)
    found["components"]["responses"] = {str(status): _problem(status) for status in PROBLEM_TYPES}
    for path, item in found["paths"].items():
        for method, operation in item.items():
            _complete(operation, path, method)
    _link([operation for item in found["paths"].values() for operation in item.values()])
    found["components"]["schemas"] = dict(sorted(schemas.items()))
    return found


def _complete(operation: dict[str, Any], path: str, method: str) -> None:
    """Parameters as they really are, errors as they really look."""
    name = operation["operationId"]
    parameters = operation.get("parameters", [])
    for parameter in parameters:
        if parameter["in"] == "path" and parameter["name"] in PATH_SCHEMAS:
            parameter["schema"] = PATH_SCHEMAS[parameter["name"]]
    statuses = {500}
    if name not in OPEN:
        statuses |= {401, 403, 503}
        operation["security"] = [{"key": []}, {}]  # none is needed while there are no keys
    if name == "readyz":
        statuses.add(503)
    if "{" in path:
        statuses.add(404)
    if any(parameter["in"] != "path" for parameter in parameters) or "{index}" in path:
        statuses.add(422)
    if "requestBody" in operation:
        statuses.update(BODY_ERRORS)
    if name in CONFLICTS:
        statuses.add(409)
    if name in RANGES:
        statuses |= {400, 416}
    statuses.update(LIMITED.get(name, ()))
    answers = {status: body for status, body in operation["responses"].items() if status < "400"}
    for status in sorted(statuses):
        answers[str(status)] = {"$ref": f"#/components/responses/{status}"}
    for success in answers.keys() & {"200", "201", "202"}:
        if name in CREATES:
            answers[success]["headers"] = {header: HEADERS[header] for header in CREATES[name]}
    operation["responses"] = answers


def _link(operations: list[dict[str, Any]]) -> None:
    """Tell of whatever makes a thing what may be done with it by its id."""
    named = {operation["operationId"]: operation for operation in operations}
    for operation in operations:
        name = operation["operationId"]
        for parameter in operation.get("parameters", []):
            thing = parameter["name"]
            if thing in MADE_BY and parameter["in"] == "path":
                made = named[MADE_BY[thing]]["responses"]
                for success in sorted(made.keys() & {"200", "201", "202"}):
                    links = made[success].setdefault("links", {})
                    links[name] = {"operationId": name, "parameters": {thing: "$response.body#/id"}}


def _problem(status: int) -> dict[str, Any]:
    kind, title = PROBLEM_TYPES[status]
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    example = {
        "type": f"/problems/{kind}",
        "title": title,
        "status": status,
        "detail": f"{title}.",
        "remedy": "",
        "errors": [],
    }
    answer: dict[str, Any] = {
        "description": f"{title}.",
        "content": {MEDIA_TYPE: {"schema": schema, "example": example}},
    }
    if status in (429, 503):
        answer["headers"] = {"Retry-After": HEADERS["Retry-After"]}
    if status == 401:
        answer["headers"] = {"WWW-Authenticate": {"schema": {"type": "string"}}}
    return answer


def _name_choices(schemas: dict[str, Any]) -> None:
    """Name what the engine offers today; the models leave it open."""
    methods_schema = {"type": "string", "enum": list(methods.names())}
    for request in ("JobRequest", "SweepRequest"):
        schemas[request]["properties"]["preset"]["enum"] = list(presets.names())
    schemas["JobRequest"]["properties"]["method"]["anyOf"] = [methods_schema, {"type": "null"}]
    schemas["SweepRequest"]["properties"]["methods"]["items"] = methods_schema
    shape = schemas["BuiltInShape"]["properties"]["shape"]
    shape["anyOf"] = [
        {"enum": list(shapes.names())},
        {"pattern": f"^{TEXT_PREFIX}[A-Za-z0-9]{{1,{min(TEXT_LIMIT, 58)}}}$"},
    ]
