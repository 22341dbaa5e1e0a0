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
    """A share link with its secret, shown this once."""

    secret: str = Field(description="Reads the job as a bearer key.")
    path: str = Field(description="Where the page shows the job, below the service's address.")
