"""Multipart forms: their files streamed to disk, their fields to memory."""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from chamfer_morph.server.http.body import chunks, too_large
from chamfer_morph.server.http.problems import ProblemError
from chamfer_morph.server.http.uploads import TemporaryFile, Upload
from chamfer_morph.worker.settings import Settings

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

PARTS = 16


@dataclass
class Form:
    """A multipart form that has come in.

    Attributes:
        fields: Plain fields by name.
        files: Files by name of their field.
    """

    fields: dict[str, bytes] = field(default_factory=dict)
    files: dict[str, Upload] = field(default_factory=dict)


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
        opened: dict[str, TemporaryFile] = {}
        async for chunk in chunks(request, largest, settings):
            try:
                parser.write(chunk)
            except FormParserError:
                _no_form()
            for part, data in parts.take():
                name, filename = part.described()
                if name in files:
                    if not part.begun:
                        if name in opened:
                            raise _repeated(name)
                        new = TemporaryFile.open(folder, filename, settings.upload_bytes)
                        opened[name] = await stack.enter_async_context(new)
                        part.begun = True
                    await opened[name].write(data)
                else:
                    if not part.begun and name in form.fields:
                        raise _repeated(name)
                    part.begun = True
                    value = form.fields.get(name, b"") + data
                    if len(value) > settings.body_bytes:
                        raise too_large(settings.body_bytes)
                    form.fields[name] = value
        try:
            parser.finalize()
        except FormParserError:
            _no_form()
        if not parts.ended:
            _no_form()
        for name, file in opened.items():
            form.files[name] = await file.close()
        yield form


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


def _repeated(name: str) -> ProblemError:
    return ProblemError(422, f"The form has two parts {name!r}.", "Send each part once.")


def _no_form() -> NoReturn:
    raise ProblemError(
        422,
        "The body is not a whole multipart form.",
        "Let an HTTP library make it, as in `curl -F file=@bunny.obj`.",
    )
