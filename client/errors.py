"""What the service refused, or that it cannot be reached, as a cause and a remedy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from morph_engine.errors import MorphError

if TYPE_CHECKING:
    import httpx

REFUSED, UNREACHABLE = 2, 3

NO_KEY = 401

_REMEDIES = {
    NO_KEY: "Give a key with --key or MORPH_KEY; morph keys create makes one.",
    403: "Use a key that is permitted to do this.",
    404: "Check the id; morph jobs lists those of jobs.",
    413: "Send less data at a time.",
    429: "Try again later.",
}

_SERVER_FAULT = "Try again later; the log of the service has details."


class ServiceError(MorphError):
    """The service refused what was asked, or failed at it; without an HTTP status, no answer."""

    def __init__(self, cause: str, remedy: str, status: int | None = None) -> None:
        super().__init__(cause, remedy)
        self.status = status

    @property
    def exit_status(self) -> int:
        """2 if the user can mend it, 3 if the service does not serve."""
        return REFUSED if self.status is not None and self.status < 500 else UNREACHABLE


def refusal(response: httpx.Response) -> ServiceError:
    """The error that an answer with a status of 400 and above stands for."""
    status = response.status_code
    document = _problem(response)
    detail = document.get("detail") or document.get("title")
    cause = detail or f"The service answered {status} {response.reason_phrase}"
    general = _SERVER_FAULT if status >= 500 else "Change the request."
    remedy = _REMEDIES.get(status, general)
    if status != NO_KEY:
        remedy = document.get("remedy") or remedy
    return ServiceError(_sentence(cause), _sentence(remedy), status)


def unreachable(server: str, error: Exception) -> ServiceError:
    """The error for a service that does not answer."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return ServiceError(
        f"There is no answer from {server} ({reason.rstrip('.')}).",
        "Start the service with morph serve, or name another one with --server or MORPH_SERVER.",
    )


def unexpected_answer(server: str) -> ServiceError:
    """The error for an answer that is not of this service."""
    return ServiceError(
        f"The server at {server} is not this version of the morph service.",
        "Check the address in --server or MORPH_SERVER.",
    )


def _problem(response: httpx.Response) -> dict[str, Any]:
    """The problem document of an answer, empty if a proxy or something else wrote it."""
    try:
        document = response.json()
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}


def _sentence(text: object) -> str:
    line = " ".join(str(text).split())
    return line if line.endswith((".", "!", "?")) else f"{line}."
