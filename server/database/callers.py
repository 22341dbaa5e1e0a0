"""Whoever sends a request: by a key, by a share link, or without either."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from chamfer_morph.schemas import Scope
from chamfer_morph.worker.job_record import JobRecord

SCOPE_ORDER: tuple[Scope, ...] = ("read", "submit", "admin")
"""Each scope includes those before it."""


@dataclass(frozen=True)
class SharedJob:
    """A job as share links name it.

    Attributes:
        id: Its id, which a later job may have too if it is submitted with the same Idempotency-Key.
        created_at: When it was submitted [milliseconds since 1970].
    """

    id: str
    created_at: int

    @staticmethod
    def of(job: JobRecord) -> SharedJob:
        """A job of the queue."""
        return SharedJob(job.id, job.age_and_id[0])


@dataclass(frozen=True)
class Caller:
    """Whoever sends a request.

    Attributes:
        name: Name of the key, which owns what it makes; empty without keys. That of a share link
            has a space, which no key's has.
        scope: The widest scope of the key.
        shared: The one job that a share link shows; None for a key.
        digest: What tells its secret from others; empty without keys.
    """

    name: str
    scope: Scope
    shared: SharedJob | None = None
    digest: str = ""

    def has_scope(self, scope: Scope) -> bool:
        """Whether the key includes a scope."""
        return SCOPE_ORDER.index(scope) <= SCOPE_ORDER.index(self.scope)

    def can_see(self, owner: str) -> bool:
        """Whether the key may see what an owner made."""
        return self.shared is None and (self.name == owner or self.has_scope("admin"))

    def can_see_job(self, job: JobRecord) -> bool:
        """Whether the key, or the share link, may see a job."""
        if self.shared is not None:
            return self.shared == SharedJob.of(job)
        return self.can_see(job.owner)

    @property
    def owner_filter(self) -> str | None:
        """The owner whose things this key may list; None for everybody's."""
        return None if self.has_scope("admin") else self.name


def secret_digest(secret: str) -> str:
    """What is stored of a secret: its SHA-256, enough for 32 random bytes."""
    return hashlib.sha256(secret.encode()).hexdigest()
