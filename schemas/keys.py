"""API keys."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, Field

from chamfer_morph.schemas.types import Request, Scope


class KeyRequest(Request):
    """A new API key."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")
    scopes: list[Scope] = Field(default=["read", "submit"], min_length=1)


class Key(BaseModel):
    """An API key without its secret."""

    name: str
    scopes: list[Scope]
    created_at: datetime


class NewKey(Key):
    """A key with its secret, shown only once."""

    secret: str
