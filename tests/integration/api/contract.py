"""The committed contract, and whether an answer of the API keeps to it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import httpx

ROOT = Path(__file__).resolve().parents[3]
CONTRACT = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))
OPERATIONS: list[tuple[str, str, dict[str, Any]]] = [
    (method, path, operation)
    for path, item in CONTRACT["paths"].items()
    for method, operation in item.items()
]
PATTERNS = [
    (method.upper(), re.compile(re.sub(r"{\w+}", "[^/]+", path)), operation)
    for method, path, operation in OPERATIONS
]


def check_documented(answer: httpx.Response) -> None:
    """Refuse an answer whose status the contract does not know for what was asked."""
    method, path = answer.request.method, answer.request.url.path
    for known, pattern, operation in PATTERNS:
        if known == method and pattern.fullmatch(path):
            status = str(answer.status_code)
            assert status in operation["responses"], (operation["operationId"], status)
