"""/v1/jobs/{id}/share-links: let others read one job without a key, until the link is revoked."""

from __future__ import annotations

from fastapi import APIRouter, Response

from chamfer_morph.schemas import NewShareLink, ShareLink
from chamfer_morph.schemas.ids import is_id
from chamfer_morph.server.auth import AuthenticatedRoute, Reader, Submitter, key_revoked
from chamfer_morph.server.context import Context
from chamfer_morph.server.database.callers import SharedJob
from chamfer_morph.server.http.problems import not_found
from chamfer_morph.server.routes.job_lookup import VisibleJob

router: APIRouter = APIRouter(
    prefix="/jobs/{job_id}/share-links", tags=["share links"], route_class=AuthenticatedRoute
)


@router.get("", operation_id="listShareLinks", summary="List its share links")
def list_share_links(caller: Reader, job: VisibleJob, context: Context) -> list[ShareLink]:
    """The links to a job without their secrets, the oldest first."""
    return context.share_links.of_job(SharedJob.of(job))


@router.post("", status_code=201, operation_id="makeShareLink", summary="Share a job")
def make_share_link(
    caller: Submitter, job: VisibleJob, response: Response, context: Context
) -> NewShareLink:
    """Make a link that shows this job to anyone who has it. The secret is shown only once.

    It gives read access to the job, its frames and files, but not to its log or anything else. It
    works until it is revoked, the job is deleted, or the key that made it is revoked.
    """
    shared = SharedJob.of(job)
    with context.quotas.letting_in_share_link(
        job.id, lambda: len(context.share_links.of_job(shared))
    ):
        link, secret = context.share_links.add(shared, caller.name)
        if context.is_revoked(caller):
            context.share_links.remove(shared, link.id)
            raise key_revoked()
    response.headers["Location"] = f"/v1/jobs/{job.id}/share-links/{link.id}"
    # what is after the # stays in the browser: no log and no proxy sees the secret
    path = f"/shared/{job.id}#{secret}"
    return NewShareLink(**link.model_dump(), secret=secret, path=path)


@router.delete(
    "/{link_id}", status_code=204, operation_id="revokeShareLink", summary="Revoke a share link"
)
def revoke_share_link(caller: Submitter, job: VisibleJob, link_id: str, context: Context) -> None:
    """The link stops working at once."""
    if not is_id(link_id) or not context.share_links.remove(SharedJob.of(job), link_id):
        raise not_found("share link", link_id)
