"""What was measured as one document, with the machine, the code and the day."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

from morph_engine.results.provenance import commit, cpu_name


def machine() -> str:
    """Where this runs, and how busy it was."""
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return f"{cpu_name()}, {os.cpu_count()} cores, load {load}, Python {platform.python_version()}"


def document(rows: Sequence[dict[str, Any]], **conditions: str) -> str:
    """Rows as JSON, and the conditions under which they were measured, when and by which commit."""
    return json.dumps(fields(rows, **conditions), indent=1) + "\n"


def fields(rows: Sequence[dict[str, Any]], **conditions: str) -> dict[str, Any]:
    """Rows, and the conditions under which they were measured, when and by which commit."""
    now = datetime.now(timezone.utc)
    return {
        "machine": machine(),
        "commit": commit(),
        "date": f"{now:%Y-%m-%d}",
        **conditions,
        "rows": rows,
    }
