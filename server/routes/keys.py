"""/v1/keys: make, list and revoke API keys."""

from __future__ import annotations

from typing import Any

import anyio
from fastapi import APIRouter, Request, Response

from chamfer_morph.schemas import Key, KeyRequest, NewKey
from chamfer_morph.server.auth import Admin, Gate
from chamfer_morph.server.context import Service, Services
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
def list_keys(caller: Admin, service: Services) -> list[Key]:
    """All keys without their secrets, the oldest first."""
    return service.keyring.keys()


@router.post("", status_code=201, operation_id="makeKey", summary="Make a key", openapi_extra=BODY)
async def make_key(
    request: Request, response: Response, caller: Admin, service: Services
) -> NewKey:
    """The secret is shown this once. From the first key on, every request needs one."""
    wanted = await read_json(request, KeyRequest, service.settings)
    key = await anyio.to_thread.run_sync(_make, wanted, service)
    _gate(request).forget()
    response.headers["Location"] = f"/v1/keys/{key.name}"
    return key


@router.delete("/{name}", status_code=204, operation_id="revokeKey", summary="Revoke a key")
def revoke_key(name: str, request: Request, caller: Admin, service: Services) -> None:
    """From now on the key is worth nothing; its jobs and meshes stay."""
    keys = {key.name: key for key in service.keyring.keys()}
    if name not in keys:
        raise not_found("key", name)
    others = [key for key in keys.values() if key.name != name]
    if others and not any("admin" in key.scopes for key in others):
        raise ProblemError(
            409,
            f"{name} is the last key that can make keys.",
            "Revoke the others first, or make another with the scope admin.",
        )
    service.keyring.remove(name)
    _gate(request).forget()


def _make(wanted: KeyRequest, service: Service) -> NewKey:
    if "admin" not in wanted.scopes and not service.keyring.keys():
        raise ProblemError(
            409,
            "The first key must have the scope admin, or nobody could make another.",
            'Add "admin" to its scopes.',
        )
    made = service.keyring.add(wanted.name, wanted.scopes)
    if made is None:
        raise ProblemError(
            409, f"There is a key {wanted.name!r} already.", "Revoke it, or choose another name."
        )
    key, secret = made
    return NewKey(**key.model_dump(), secret=secret)


def _gate(request: Request) -> Gate:
    gate: Gate = request.app.state.gate
    return gate
