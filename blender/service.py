"""The morph service over HTTP, with the standard library alone: Blender brings no HTTP client."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import Request, urlopen

TIMEOUT_SECONDS = 60.0

Json = dict[str, Any]


class ServiceError(Exception):
    """The service refused a request, or is not there; the message says what to do about it.

    Args:
        message: A sentence or two.
        status: HTTP status; 0 where there was no answer.
    """

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status: int = status

    @property
    def passes(self) -> bool:
        """Whether it may soon be over, as when the service starts again or has much to do."""
        return self.status in (0, 429) or self.status >= 500


class Service:
    """A morph service.

    Args:
        address: Such as http://127.0.0.1:8000.
        key: API key; empty where none is needed.
    """

    def __init__(self, address: str, key: str = "") -> None:
        self.address: str = address.rstrip("/")
        self._headers = {"Authorization": f"Bearer {key}"} if key else {}

    def upload(self, mesh: Path) -> str:
        """Send a mesh file; returns its id."""
        headers = {"Content-Type": "application/octet-stream"}
        path = f"/v1/meshes?name={quote(mesh.name)}"
        return str(self._send("POST", path, mesh.read_bytes(), headers)["id"])

    def submit(self, request: Json) -> str:
        """Queue a job; returns its id."""
        return str(self._post("/v1/jobs", request)["id"])

    def job(self, job: str) -> Json:
        """A job as it stands."""
        return self._send("GET", f"/v1/jobs/{job}")

    def cancel(self, job: str) -> None:
        """Stop a job."""
        self._post(f"/v1/jobs/{job}/cancel", {})

    def begin_export(self, job: str, request: Json) -> Json:
        """Ask for frames in another format; `export` tells how far it is."""
        return self._post(f"/v1/jobs/{job}/exports", request)

    def export(self, export: Json) -> Json:
        """An export as it stands."""
        return self._send("GET", export["links"]["self"])

    def download(self, path: str, to: Path) -> None:
        """Fetch a file."""
        with self._open("GET", path) as answer, to.open("wb") as file:
            shutil.copyfileobj(answer, file)

    def _post(self, path: str, body: Json) -> Json:
        headers = {"Content-Type": "application/json"}
        return self._send("POST", path, json.dumps(body).encode(), headers)

    def _send(
        self, method: str, path: str, body: bytes | None = None, headers: Json | None = None
    ) -> Json:
        with self._open(method, path, body, headers) as answer:
            document: Json = json.loads(answer.read() or b"{}")
            return document

    @contextmanager
    def _open(
        self, method: str, path: str, body: bytes | None = None, headers: Json | None = None
    ) -> Iterator[Any]:
        """The answer to a request, as a file; what fails while it is read is told as well."""
        try:
            request = Request(
                self.address + path,
                data=body,
                method=method,
                headers=self._headers | (headers or {}),
            )
            with urlopen(request, timeout=TIMEOUT_SECONDS) as answer:
                yield answer
        except HTTPError as error:
            raise ServiceError(_explained(error), error.code) from error
        except (OSError, HTTPException, ValueError) as error:
            raise ServiceError(
                f"No morph service answers at {self.address}. Start one with `morph serve`, or "
                "set its address in the preferences of the add-on."
            ) from error


def _explained(error: HTTPError) -> str:
    """What a problem document says, or else the status."""
    try:
        problem = json.loads(error.read())
        return f"{problem['detail']} {problem.get('remedy', '')}".strip()
    except (ValueError, KeyError, TypeError):
        return f"The service answered {error.code} {error.reason}."
