"""Share links: who has one reads one job. Only a digest of each secret is stored."""

from __future__ import annotations

import secrets
from collections.abc import Collection

import sqlalchemy as sa
from sqlalchemy.orm import Session

from chamfer_morph.schemas import ShareLink
from chamfer_morph.schemas.ids import new_id
from chamfer_morph.server.database.callers import Caller, SharedJob, secret_digest
from chamfer_morph.server.database.tables import ShareLinkRow, as_time, insert, now

PREFIX = "share_"
"""Tells the secret of a link from a key."""


class ShareLinkStore:
    """The share links in the database. Calls block."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def callers(self, digests: Collection[str]) -> dict[str, Caller]:
        """Whoever has one of the links with these digests, by digest, without those revoked."""
        query = sa.select(ShareLinkRow).where(ShareLinkRow.digest.in_(digests))
        with Session(self._engine) as session:
            rows = session.scalars(query).all()
        return {
            row.digest: Caller(
                f"link {row.id}", "read", SharedJob(row.job, row.job_created_at), row.digest
            )
            for row in rows
        }

    def of_job(self, job: SharedJob) -> list[ShareLink]:
        """The links to a job, the oldest first."""
        query = sa.select(ShareLinkRow).where(*_to(job)).order_by(ShareLinkRow.created_at)
        with Session(self._engine) as session:
            return [_link(row) for row in session.scalars(query)]

    def add(self, job: SharedJob, owner: str) -> tuple[ShareLink, str]:
        """Make a link.

        Args:
            job: What it shows.
            owner: Name of the key that makes it.

        Returns:
            The link and its secret, which is shown this once.
        """
        secret = PREFIX + secrets.token_urlsafe(32)
        digest = secret_digest(secret)
        row = ShareLinkRow(new_id(), job.id, job.created_at, owner, digest, now())
        insert(self._engine, row)
        return _link(row), secret

    def remove(self, job: SharedJob, link_id: str) -> bool:
        """Revoke a link to a job; False if there is none."""
        return self._remove(*_to(job), ShareLinkRow.id == link_id)

    def remove_of_job(self, job_id: str) -> None:
        """Revoke all links to a job, which goes."""
        self._remove(ShareLinkRow.job == job_id)

    def remove_of(self, owner: str) -> None:
        """Revoke all links that a key has made."""
        self._remove(ShareLinkRow.owner == owner)

    def _remove(self, *conditions: sa.ColumnElement[bool]) -> bool:
        with self._engine.begin() as connection:
            return bool(connection.execute(sa.delete(ShareLinkRow).where(*conditions)).rowcount)


def _to(job: SharedJob) -> tuple[sa.ColumnElement[bool], ...]:
    return ShareLinkRow.job == job.id, ShareLinkRow.job_created_at == job.created_at


def _link(row: ShareLinkRow) -> ShareLink:
    return ShareLink(id=row.id, job=row.job, created_at=as_time(row.created_at))
