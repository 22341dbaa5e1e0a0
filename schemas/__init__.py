"""What the API takes and answers, as pydantic models that depend on nothing else."""

from __future__ import annotations

from chamfer_morph.schemas.catalog import ExportFormat, ParticleField, Resource
from chamfer_morph.schemas.events import Event, EventPage
from chamfer_morph.schemas.exports import CameraKey, Export, ExportRequest, PictureOptions
from chamfer_morph.schemas.jobs import (
    ForkOrigin,
    ForkRequest,
    Job,
    JobPage,
    JobRequest,
    JobState,
    Outcome,
    Progress,
)
from chamfer_morph.schemas.keys import Key, KeyRequest, NewKey
from chamfer_morph.schemas.meshes import Mesh, MeshPage
from chamfer_morph.schemas.playback import Playback
from chamfer_morph.schemas.problems import Problem, ProblemDocument
from chamfer_morph.schemas.queue import QueueStatus
from chamfer_morph.schemas.shapes import BuiltInShape, MeshShape, Shape
from chamfer_morph.schemas.share_links import NewShareLink, ShareLink
from chamfer_morph.schemas.sweeps import Sweep, SweepRequest, SweepRow
from chamfer_morph.schemas.types import (
    Device,
    Easing,
    Fit,
    FrameFormat,
    JobStage,
    Repeat,
    Scope,
    Sha256,
    SurfaceFormat,
    Units,
)
from chamfer_morph.schemas.webhooks import (
    Delivery,
    DeliveryAttempt,
    DeliveryPage,
    NewWebhook,
    Webhook,
    WebhookRequest,
)
from chamfer_morph.schemas.workers import WorkerStatus

__all__ = [
    "BuiltInShape",
    "CameraKey",
    "Delivery",
    "DeliveryAttempt",
    "DeliveryPage",
    "Device",
    "Easing",
    "Event",
    "EventPage",
    "Export",
    "ExportFormat",
    "ExportRequest",
    "Fit",
    "ForkOrigin",
    "ForkRequest",
    "FrameFormat",
    "Job",
    "JobPage",
    "JobRequest",
    "JobStage",
    "JobState",
    "Key",
    "KeyRequest",
    "Mesh",
    "MeshPage",
    "MeshShape",
    "NewKey",
    "NewShareLink",
    "NewWebhook",
    "Outcome",
    "ParticleField",
    "PictureOptions",
    "Playback",
    "Problem",
    "ProblemDocument",
    "Progress",
    "QueueStatus",
    "Repeat",
    "Resource",
    "Scope",
    "Sha256",
    "Shape",
    "ShareLink",
    "SurfaceFormat",
    "Sweep",
    "SweepRequest",
    "SweepRow",
    "Units",
    "Webhook",
    "WebhookRequest",
    "WorkerStatus",
]
