"""The log of the service's processes: lines to read, or JSON objects with the ids of jobs."""

from __future__ import annotations

import json
import logging
import sys
from contextvars import ContextVar
from datetime import datetime, timezone
from types import TracebackType
from typing import Any

from chamfer_morph.worker import telemetry

job_id: ContextVar[str] = ContextVar("job_id", default="")
"""The job that is worked on; empty where there is none."""

request_id: ContextVar[str] = ContextVar("request_id", default="")
"""The request that is answered, or that the job was last queued by; empty where there is none."""

of_process: dict[str, str] = {}
"""What all lines of this process tell, as those of an engine that has one job."""

TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"

TOLD = ("chamfer_morph.audit", "chamfer_morph.jobs")
"""Loggers whose lines of level INFO are written, too."""

_audit: logging.Logger = logging.getLogger("chamfer_morph.audit")


def set_up(log_format: str) -> None:
    """Write the log of this process to standard error, as `text` or `json`."""
    handler = logging.StreamHandler()
    as_json = log_format == "json"
    handler.setFormatter(JsonFormatter() if as_json else logging.Formatter(TEXT))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    # DBOS gives its logger a format of its own, unless that has a handler already
    logging.getLogger("dbos").addHandler(logging.NullHandler())
    for name in TOLD if as_json else TOLD[:1]:
        logging.getLogger(name).setLevel(logging.INFO)


def set_up_engine(log_format: str) -> None:
    """The same for an engine, whose warnings and last exception are lines of the log, too."""
    if log_format == "json":
        set_up(log_format)
        logging.captureWarnings(True)
        sys.excepthook = _log_exception


def log_change(message: str, operation: str, **fields: Any) -> None:
    """Log what changed without a request, by the operation of the API that does the same."""
    now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    line = {"time": now, "operation": operation, **fields}
    _audit.info(json.dumps(line), extra={"fields": line | {"message": message}})


def last_words(line: str) -> str:
    """What a line of a log tells, whichever format it has."""
    try:
        told = json.loads(line)
        return str(told.get("error") or told["message"]).strip().splitlines()[-1]
    except (ValueError, LookupError, AttributeError):  # text
        return line


def _log_exception(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    logging.getLogger(__name__).critical("%s", error, exc_info=(kind, error, traceback))


class JsonFormatter(logging.Formatter):
    """A line is one JSON object.

    It has `time` in UTC, `level`, `logger`, `message`, `job` where the line is about one, `request`
    that is answered or has queued the job, `trace_id` and `span_id` where a span is active, `error`
    with the traceback where there is one, and what the caller gave as `extra={"fields": {...}}`.
    """

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record."""
        time = datetime.fromtimestamp(record.created, timezone.utc)
        line: dict[str, Any] = {
            "time": time.isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
        }
        line |= of_process
        if job := job_id.get():
            line["job"] = job
        if request := request_id.get():
            line["request"] = request
        line |= telemetry.ids()
        fields = getattr(record, "fields", None)
        line |= fields if fields is not None else {}
        line.setdefault("message", record.getMessage())
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)
