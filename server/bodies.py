"""Request bodies: JSON of a bounded size, files and forms streamed to disk."""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from collections.abc import AsyncIterator, Collection
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TypeVar

import anyio
from pydantic import BaseModel, ValidationError
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from server.problems import ProblemError, invalid
from worker.settings import Settings

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

WRITE_BYTES = 1 << 20
PARTS = 16
NAME_LENGTH = 200

Model = TypeVar("Model", bound=BaseModel)


@dataclass
class Upload:
    """A file that has come in.

    Attributes:
        path: Where it lies for the time of the request.
        name: What the user calls it.
        sha256: Digest of its content.
        size_bytes: Its size.
    """

    path: Path
    name: str
    sha256: str
    size_bytes: int


@dataclass
class Form:
    """A multipart form that has come in.

    Attributes:
        fields: Plain fields by name.
        files: Files by name of their field.
    """

    fields: dict[str, bytes] = field(default_factory=dict)
    files: dict[str, Upload] = field(default_factory=dict)


def media_type(request: Request) -> str:
    """Type of the body in lower case, without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def read_json(request: Request, model: type[Model], settings: Settings) -> Model:
    """The body as JSON of a known shape.

    Raises:
        ProblemError: 415, 413, 408 or 422.
    """
    if media_type(request) != "application/json":
        raise ProblemError(
            415, "The body is not JSON.", "Send it with Content-Type: application/json."
        )
    body = bytearray()
    async for chunk in _chunks(request, settings.body_bytes, settings):
        body += chunk
    return parse_json(bytes(body), model)


def parse_json(body: bytes, model: type[Model]) -> Model:
    """JSON of a known shape.

    Raises:
        ProblemError: 422.
    """
    return validate(load_json(body), model)


def load_json(body: bytes) -> object:
    """Any JSON, without the numbers that JSON does not have.

    Raises:
        ProblemError: 422.
    """
    try:
        return json.loads(body, parse_constant=_refuse_constant)
    except RecursionError:
        raise ProblemError(422, "The JSON is nested too deeply.", "Flatten it.") from None
    except ValueError as error:
        raise ProblemError(
            422, f"The body is not JSON: {error}.", "Check it with a JSON linter."
        ) from None


def validate(value: object, model: type[Model]) -> Model:
    """A value of a known shape.

    Raises:
        ProblemError: 422.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise invalid(error) from None


@asynccontextmanager
async def receive_file(
    request: Request, folder: Path, name: str, settings: Settings
) -> AsyncIterator[Upload]:
    """Stream the body to a temporary file, gone after the request unless it was moved.

    Raises:
        ProblemError: 413 too large, 408 stalled, 400 cut off.
    """
    async with _Sink.open(folder, name) as sink:
        async for chunk in _chunks(request, settings.upload_bytes, settings):
            await sink.write(chunk)
        yield await sink.close()


@asynccontextmanager
async def receive_form(
    request: Request, folder: Path, *, files: Collection[str], settings: Settings
) -> AsyncIterator[Form]:
    """Stream a multipart form: its files to temporary ones, its fields to memory.

    Args:
        request: The request.
        folder: Where to put the files.
        files: Names of the fields that hold files.
        settings: The limits of a file and of a field.

    Raises:
        ProblemError: 413 too large, 408 stalled, 400 cut off, 422 not a form or an unknown part.
    """
    _, options = parse_options_header(request.headers.get("content-type"))
    form, parts = Form(), _Parts()
    try:
        parser = MultipartParser(options.get(b"boundary") or _no_form(), parts.callbacks())
    except FormParserError:
        _no_form()
    largest = settings.upload_bytes * max(len(files), 1) + settings.body_bytes
    async with AsyncExitStack() as stack:
        sinks: dict[str, _Sink] = {}
        async for chunk in _chunks(request, largest, settings):
            try:
                parser.write(chunk)
            except FormParserError:
                _no_form()
            for part, data in parts.take():
                name, filename = part.described()
                if name in files:
                    if name not in sinks:
                        if part.begun:
                            raise _repeated(name)
                        folder_sink = _Sink.open(folder, filename, settings.upload_bytes)
                        sinks[name] = await stack.enter_async_context(folder_sink)
                        part.begun = True
                    elif not part.begun:
                        raise _repeated(name)
                    await sinks[name].write(data)
                else:
                    if not part.begun and name in form.fields:
                        raise _repeated(name)
                    part.begun = True
                    value = form.fields.get(name, b"") + data
                    if len(value) > settings.body_bytes:
                        raise _too_large(settings.body_bytes)
                    form.fields[name] = value
        try:
            parser.finalize()
        except FormParserError:
            _no_form()
        if not parts.ended:
            _no_form()
        for name, sink in sinks.items():
            form.files[name] = await sink.close()
        yield form


def plain_name(name: str) -> str:
    """The last part of a file name as a user may send it, without control characters."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(letter for letter in last if letter.isprintable()).strip()[-NAME_LENGTH:]


class _Sink:
    """A temporary file being written, in pieces large enough to be worth a thread's while."""

    def __init__(self, path: Path, name: str, largest: int | None) -> None:
        self._path, self._name, self._largest = path, name, largest
        self._file = path.open("xb")
        self._digest = hashlib.sha256()
        self._buffer = bytearray()
        self._size = 0

    @classmethod
    @asynccontextmanager
    async def open(
        cls, folder: Path, name: str, largest: int | None = None
    ) -> AsyncIterator[_Sink]:
        name = plain_name(name)
        suffix = Path(name).suffix.lower()
        path = folder / f"{secrets.token_hex(12)}{suffix if suffix[1:].isalnum() else ''}"
        sink = cls(path, name, largest)
        try:
            yield sink
        finally:
            sink._file.close()
            path.unlink(missing_ok=True)

    async def write(self, data: bytes) -> None:
        self._buffer += data
        self._size += len(data)
        if self._largest is not None and self._size > self._largest:
            raise _too_large(self._largest)
        if len(self._buffer) >= WRITE_BYTES:
            await anyio.to_thread.run_sync(self._flush)

    async def close(self) -> Upload:
        await anyio.to_thread.run_sync(self._flush)
        self._file.close()
        return Upload(self._path, self._name, self._digest.hexdigest(), self._size)

    def _flush(self) -> None:
        data, self._buffer = self._buffer, bytearray()
        self._digest.update(data)
        self._file.write(data)


class _Part:
    """One part of a form, as its headers describe it."""

    def __init__(self) -> None:
        self.disposition = b""
        self.begun = False

    def described(self) -> tuple[str, str]:
        """Name of the field, and of the file if any."""
        _, options = parse_options_header(self.disposition)
        name = options.get(b"name", b"").decode("utf-8", "replace")
        if not name:
            _no_form()
        return name, options.get(b"filename", b"").decode("utf-8", "replace")


class _Parts:
    """Collects what the parser finds until `take`."""

    def __init__(self) -> None:
        self.ended = False
        self._found: list[tuple[_Part, bytes]] = []
        self._part = _Part()
        self._count = 0
        self._header = bytearray()
        self._value = bytearray()

    def take(self) -> list[tuple[_Part, bytes]]:
        found, self._found = self._found, []
        return found

    def callbacks(self) -> MultipartCallbacks:
        return {
            "on_part_begin": self._begin,
            "on_header_field": self._on_header,
            "on_header_value": self._on_value,
            "on_header_end": self._on_header_end,
            "on_headers_finished": lambda: self._found.append((self._part, b"")),
            "on_part_data": self._on_data,
            "on_end": self._end,
        }

    def _begin(self) -> None:
        self._part = _Part()
        self._count += 1
        if self._count > PARTS:
            raise ProblemError(413, f"The form has more than {PARTS} parts.", "Send fewer.")

    def _on_header(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def _on_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _on_header_end(self) -> None:
        if self._header.lower() == b"content-disposition":
            self._part.disposition = bytes(self._value)
        self._header.clear()
        self._value.clear()

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        self._found.append((self._part, data[start:end]))

    def _end(self) -> None:
        self.ended = True


async def _chunks(request: Request, largest: int, settings: Settings) -> AsyncIterator[bytes]:
    """The body as it comes in.

    Raises:
        ProblemError: 413 too large, 408 stalled, 400 cut off.
    """
    declared = request.headers.get("content-length", "")
    if declared.isdigit() and int(declared) > largest:
        raise _too_large(largest)
    stall, size = settings.upload_timeout_seconds, 0
    while True:
        try:
            with anyio.fail_after(stall):
                message = await request.receive()
        except TimeoutError:
            raise ProblemError(
                408,
                f"Nothing has come for {stall:g} s.",
                "Send it again, over a steadier connection.",
                headers={"Connection": "close"},
            ) from None
        if message["type"] == "http.disconnect":
            raise ProblemError(400, "The body was cut off.", "Send it again.") from None
        chunk: bytes = message.get("body", b"")
        size += len(chunk)
        if size > largest:
            raise _too_large(largest)
        if chunk:
            yield chunk
        if not message.get("more_body", False):
            return


def _too_large(largest: int) -> ProblemError:
    text = f"{largest / 2**20:.0f} MiB" if largest >= 1 << 20 else f"{largest} bytes"
    return ProblemError(
        413,
        f"This is larger than the {text} that are accepted.",
        "Send less; a mesh may be decimated, for the simulation sees no detail below half a grid "
        "unit.",
        headers={"Connection": "close", "Retry-After": "60"},
    )


def _repeated(name: str) -> ProblemError:
    return ProblemError(422, f"The form has two parts {name!r}.", "Send each part once.")


def _no_form() -> NoReturn:
    raise ProblemError(
        422,
        "The body is not a whole multipart form.",
        "Let an HTTP library make it, as in `curl -F file=@bunny.obj`.",
    )


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number of JSON")
