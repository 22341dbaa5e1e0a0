"""The OpenAPI contract: what FastAPI finds, and what only we know."""

from __future__ import annotations

import json
from typing import Any

from fastapi import FastAPI
from pydantic.json_schema import models_json_schema

from chamfer_morph.schemas import (
    ExportRequest,
    ForkRequest,
    JobRequest,
    KeyRequest,
    ProblemDocument,
    SweepRequest,
    WebhookRequest,
    ids,
)
from chamfer_morph.server.http.problems import MEDIA_TYPE, PROBLEM_TYPES, ProblemError
from morph_engine import methods, presets
from morph_engine.geometry import shapes
from morph_engine.geometry.mesh import TEXT_PREFIX
from morph_engine.geometry.shapes import TEXT_LIMIT

MODELS = (
    ExportRequest,
    ForkRequest,
    JobRequest,
    KeyRequest,
    ProblemDocument,
    SweepRequest,
    WebhookRequest,
)
"""Those that FastAPI does not find, or of which it does not tell that a default is null."""

BODY_ERRORS = (400, 408, 409, 413, 415, 422, 429)
OPEN = ("livez", "readyz")

JOB_ID = {"type": "string", "pattern": f"^{ids.PATTERN}$"}
PATH_SCHEMAS: dict[str, dict[str, Any]] = {
    "job_id": JOB_ID,
    "sweep_id": JOB_ID,
    "export_id": JOB_ID,
    "webhook_id": JOB_ID,
    "link_id": JOB_ID,
    "mesh_id": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
    "worker_id": {"type": "string", "pattern": "^[A-Za-z0-9.-]+$"},
    "name": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"},
    "shape": {"type": "string", "minLength": 1, "maxLength": 64},
    "field": {"type": "string", "pattern": "^[a-z_]{1,40}$"},
}

FURTHER_ERRORS: dict[str, tuple[int, ...]] = {
    "deleteMesh": (409,), "deleteJob": (409,), "cancelJob": (409,), "revokeKey": (409,),
    "putJobFirst": (409,), "getPlayback": (409,),
    "resumeJob": (409, 413, 429), "retryJob": (409, 413, 429),
    "getResult": (400, 409, 416), "getExportFile": (400, 409, 416),
    "getMeshFile": (400, 416), "getLog": (400, 416),
    "getSurface": (413,), "getEvents": (429,), "makeShareLink": (429,),
    "testWebhook": (429,),
    "readyz": (503,),
}  # fmt: skip
"""What neither the address nor the body of an operation tells."""

HEADERS: dict[str, dict[str, Any]] = {
    "Location": {"schema": {"type": "string"}, "description": "Address of the new resource."},
    "Retry-After": {"schema": {"type": "integer"}, "description": "When to ask again [s]."},
}

MADE_BY = {
    "mesh_id": "uploadMesh", "job_id": "submitJob", "sweep_id": "submitSweep",
    "export_id": "exportJob", "webhook_id": "makeWebhook", "link_id": "makeShareLink",
}  # fmt: skip
"""The operation that makes the thing of an id."""


def install(app: FastAPI) -> None:
    """Let an application describe itself in full."""
    describe = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _completed(describe())
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def text(app: FastAPI) -> str:
    """The contract as it is committed in openapi/openapi.json."""
    return json.dumps(app.openapi(), indent=2, ensure_ascii=False) + "\n"


def _completed(found: dict[str, Any]) -> dict[str, Any]:
    """The contract with what FastAPI cannot find."""
    schemas = found["components"]["schemas"]
    _, extra = models_json_schema(
        [(model, "validation") for model in MODELS],
        ref_template="#/components/schemas/{model}",
    )
    schemas.update(extra["$defs"])
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    _name_choices(schemas)
    found["components"]["responses"] = {str(status): _problem(status) for status in PROBLEM_TYPES}
    for path, item in found["paths"].items():
        for operation in item.values():
            _complete(operation, path)
    _link([operation for item in found["paths"].values() for operation in item.values()])
    found["components"]["schemas"] = dict(sorted(schemas.items()))
    return found


def _complete(operation: dict[str, Any], path: str) -> None:
    """Parameters as they really are, errors as they really look."""
    name = operation["operationId"]
    parameters = operation.get("parameters", [])
    for parameter in parameters:
        if parameter["in"] == "path" and parameter["name"] in PATH_SCHEMAS:
            parameter["schema"] = PATH_SCHEMAS[parameter["name"]]
    statuses = {403, 500}  # without keys, other hosts and origins are refused
    if name not in OPEN:
        statuses |= {401, 503, 507}
        operation["security"] = [{"key": []}, {}]  # none is needed while there are no keys
    if "{" in path:
        statuses.add(404)
    if any(parameter["in"] != "path" for parameter in parameters) or "{index}" in path:
        statuses.add(422)
    if "requestBody" in operation:
        statuses.update(BODY_ERRORS)
    statuses.update(FURTHER_ERRORS.get(name, ()))
    answers = {status: body for status, body in operation["responses"].items() if status < "400"}
    if "requestBody" in operation:
        names = ("Location", "Retry-After") if "202" in answers else ("Location",)
        for answer in answers.values():
            answer["headers"] = {name: HEADERS[name] for name in names}
    for status in sorted(statuses):
        answers[str(status)] = {"$ref": f"#/components/responses/{status}"}
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
    detail = f"{PROBLEM_TYPES[status][1]}."
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    example = ProblemError(status, detail).document().model_dump()
    answer: dict[str, Any] = {
        "description": detail,
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
        {"pattern": f"^{TEXT_PREFIX}[A-Za-z0-9]{{1,{TEXT_LIMIT}}}$"},
    ]
