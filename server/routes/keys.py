"""/v1/keys: make, list and revoke API keys."""

from __future__ import annotations

from typing import Any

import anyio
from fastapi import APIRouter, Request, Response

from chamfer_morph.schemas import Key, KeyRequest, NewKey
from chamfer_morph.server.auth import Admin, Authenticator
from chamfer_morph.server.context import Context, ServerContext
from chamfer_morph.server.http.json_body import read_json
from chamfer_morph.server.http.problems import ProblemError, not_found

router = APIRouter(prefix="/keys", tags=["keys"])

BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": "#/components/schemas/KeyRequest"},
                "examples": {
                    "admin": {
                        "summary": "A key for whoever runs the service",
                        "value": {"name": "operator", "scopes": ["admin"]},
                    }
                },
            }
        },
    }
}


@router.get("", operation_id="listKeys", summary="List keys")
def list_keys(caller: Admin, context: Context) -> list[Key]:
    """All keys without their secrets, the oldest first."""
    return context.api_keys.all()


@router.post("", status_code=201, operation_id="makeKey", summary="Make a key", openapi_extra=BODY)
async def make_key(request: Request, response: Response, caller: Admin, context: Context) -> NewKey:
    """The secret is shown this once. From the first key on, every request needs one."""
    body = await read_json(request, KeyRequest, context.settings)
    key = await anyio.to_thread.run_sync(_create, body, context)
    _authenticator(request).invalidate()
    response.headers["Location"] = f"/v1/keys/{key.name}"
    return key


@router.delete("/{name}", status_code=204, operation_id="revokeKey", summary="Revoke a key")
def revoke_key(name: str, request: Request, caller: Admin, context: Context) -> None:
    """From now on the key is worth nothing; its jobs and meshes stay."""
    keys = {key.name: key for key in context.api_keys.all()}
    if name not in keys:
        raise not_found("key", name)
    others = [key for key in keys.values() if key.name != name]
    if others and not any("admin" in key.scopes for key in others):
        raise ProblemError(
            409,
            f"{name} is the last key that can make keys.",
            "Revoke the others first, or make another with the scope admin.",
        )
    context.api_keys.remove(name)
    _authenticator(request).invalidate()


def _create(body: KeyRequest, context: ServerContext) -> NewKey:
    if "admin" not in body.scopes and not context.api_keys.all():
        raise ProblemError(
            409,
            "The first key must have the scope admin, or nobody could make another.",
            'Add "admin" to its scopes.',
        )
    created = context.api_keys.add(body.name, body.scopes)
    if created is None:
        raise ProblemError(
            409, f"There is a key {body.name!r} already.", "Revoke it, or choose another name."
        )
    key, secret = created
    return NewKey(**key.model_dump(), secret=secret)


def _authenticator(request: Request) -> Authenticator:
    authenticator: Authenticator = request.app.state.authenticator
    return authenticator
