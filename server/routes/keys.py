"""/v1/keys: make, list and revoke API keys."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Body, Request, Response
from fastapi.openapi.models import Example

from chamfer_morph.schemas import Key, KeyRequest, NewKey
from chamfer_morph.server.auth import Admin, AuthenticatedRoute
from chamfer_morph.server.context import Context
from chamfer_morph.server.database.api_keys import LastAdminError
from chamfer_morph.server.http.problems import ProblemError, not_found

router: APIRouter = APIRouter(prefix="/keys", tags=["keys"], route_class=AuthenticatedRoute)

EXAMPLES: dict[str, Example] = {
    "admin": {
        "summary": "A key for an administrator",
        "value": {"name": "operator", "scopes": ["admin"]},
    }
}


@router.get("", operation_id="listKeys", summary="List keys")
def list_keys(caller: Admin, context: Context) -> list[Key]:
    """All keys without their secrets, the oldest first."""
    return context.api_keys.all()


@router.post("", status_code=201, operation_id="makeKey", summary="Make a key")
def make_key(
    caller: Admin,
    body: Annotated[KeyRequest, Body(openapi_examples=EXAMPLES)],
    request: Request,
    response: Response,
    context: Context,
) -> NewKey:
    """The secret is shown only once. Once a key exists, every request needs one."""
    if "admin" not in body.scopes and not context.api_keys.all():
        raise ProblemError(
            409,
            "The first key must have the scope admin; otherwise nobody could make more.",
            'Add "admin" to its scopes.',
        )
    created = context.api_keys.add(body.name, body.scopes)
    if created is None:
        raise ProblemError(
            409, f"A key {body.name!r} already exists.", "Delete it, or choose another name."
        )
    context.authenticator.invalidate()
    response.headers["Location"] = f"/v1/keys/{body.name}"
    key, secret = created
    request.state.audited = {"new_key": key.name, "scopes": key.scopes}
    return NewKey(**key.model_dump(), secret=secret)


@router.delete("/{name}", status_code=204, operation_id="revokeKey", summary="Revoke a key")
def revoke_key(name: str, caller: Admin, context: Context) -> None:
    """The key stops working at once; its jobs and meshes are kept, its webhooks are deleted."""
    try:
        found = context.api_keys.remove(name)
    except LastAdminError as error:
        raise ProblemError(409, error.cause, error.remedy) from error
    if not found:
        raise not_found("key", name)
    context.authenticator.invalidate()
