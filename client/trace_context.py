"""Requests as part of a trace of the caller's (W3C Trace Context)."""

from __future__ import annotations

import os
import re
import sys

import httpx

TRACEPARENT = re.compile(r"[0-9a-f]{2}-[0-9a-f]{32}-[0-9a-f]{16}-[0-9a-f]{2}")


async def add_trace_context(request: httpx.Request) -> None:
    """Name the active span of OpenTelemetry, where this program has one, or that of TRACEPARENT."""
    if "opentelemetry.trace" in sys.modules:
        from opentelemetry import propagate

        propagate.inject(request.headers)
    given = os.environ.get("TRACEPARENT", "")
    if "traceparent" not in request.headers and TRACEPARENT.fullmatch(given):
        request.headers["traceparent"] = given
