"""Share links: addresses by which others read one job without a key."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, Field


class ShareLink(BaseModel):
    """A share link without its secret."""

    id: str
    job: str = Field(description="The job that it shows.")
    created_at: datetime


class NewShareLink(ShareLink):
    """A share link with its secret, shown only once."""

    secret: str = Field(description="Gives read access to the job when sent as a bearer key.")
    path: str = Field(
        description="Path of the page that shows the job, relative to the address of the service."
    )
