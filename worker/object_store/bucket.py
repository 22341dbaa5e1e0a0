"""Objects in a store that speaks S3."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from chamfer_morph.worker.storage import StoreUnavailableError
from morph_engine.errors import ConfigError
from morph_engine.optional_packages import load

if TYPE_CHECKING:
    from obstore.store import S3Store

CONNECT_SECONDS, REQUEST_SECONDS = 3, 30
RETRIES, RETRY_SECONDS = 2, 5

PART_BYTES = 8 << 20
"""What is sent or asked for by one request at most, so that a slow link carries it in time;
S3 takes parts from 5 MiB on."""


class ObjectChangedError(Exception):
    """An object is not what it was when it was read: somebody else has written it."""


class Bucket:
    """Objects by key, below a prefix of a bucket. Calls block; any thread may make them.

    Args:
        store: The store.
    """

    def __init__(self, store: S3Store) -> None:
        self._store = store

    @classmethod
    def open(cls, url: str) -> Bucket:
        """The bucket of an address such as s3://bucket/prefix.

        Keys, region and endpoint come from the usual variables, such as AWS_ACCESS_KEY_ID,
        AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL. Nothing is asked of the store yet.

        Raises:
            ConfigError: The address or one of the variables cannot be used.
            ExtraError: obstore is not installed.
        """
        purpose = "Keeping files in an object store"
        store = load("obstore.store", extra="object-store", purpose=purpose)
        exceptions = load("obstore.exceptions", extra="object-store", purpose=purpose)
        try:
            return cls(
                store.S3Store.from_url(
                    url,
                    client_options={
                        "allow_http": True,  # a store of one's own may stand in the same rack
                        "connect_timeout": timedelta(seconds=CONNECT_SECONDS),
                        "timeout": timedelta(seconds=REQUEST_SECONDS),
                    },
                    retry_config={
                        "max_retries": RETRIES,
                        "retry_timeout": timedelta(seconds=RETRY_SECONDS),
                    },
                )
            )
        except (exceptions.BaseError, ValueError) as error:
            raise ConfigError(
                f"MORPH_OBJECT_STORE cannot be used ({_first_line(error)}).",
                "Use the form s3://bucket/prefix, and check the AWS_* variables.",
            ) from error

    def get(self, key: str) -> bytes:
        """An object.

        Raises:
            FileNotFoundError: There is none.
            StoreUnavailableError: The store does not answer.
        """
        with _asking():
            return bytes(self._store.get(key).bytes())

    def parts(self, key: str, end: int, begin: int = 0) -> Iterator[bytes]:
        """An object, part by part, from one place to another; its size is known [bytes].

        Raises:
            FileNotFoundError: There is none.
            StoreUnavailableError: The store does not answer.
        """
        for first in range(begin, end, PART_BYTES):
            with _asking():
                part = self._store.get_range(key, start=first, end=min(first + PART_BYTES, end))
            yield bytes(part)

    def get_unless(self, key: str, etag: str | None) -> tuple[bytes, str] | None:
        """An object and its ETag, or None where it still has the ETag that is given.

        Raises:
            FileNotFoundError: There is none.
            StoreUnavailableError: The store does not answer.
        """
        from obstore.exceptions import NotModifiedError

        with _asking():
            try:
                found = self._store.get(key, options={"if_none_match": etag} if etag else None)
                return bytes(found.bytes()), str(found.meta["e_tag"])
            except NotModifiedError:
                return None

    def put(self, key: str, data: bytes) -> None:
        """Write an object.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        with _asking():
            self._store.put(key, data, use_multipart=False)

    def put_file(self, key: str, path: Path) -> None:
        """Write an object that may be large; it is there once all of it is.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        with _asking():
            self._store.put(key, path, chunk_size=PART_BYTES, max_concurrency=1)

    def replace(self, key: str, data: bytes, etag: str | None) -> str:
        """Write an object that has still the ETag that is given, or, with None, that is not there.

        Returns:
            The new ETag.

        Raises:
            ObjectChangedError: It has another one, or has gone.
            StoreUnavailableError: The store does not answer; the object may be written or not.
        """
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        with _asking():
            try:
                written = self._store.put(
                    key, data, mode={"e_tag": etag} if etag else "create", use_multipart=False
                )
            except (AlreadyExistsError, FileNotFoundError, PreconditionError):
                raise ObjectChangedError(key) from None
        return str(written["e_tag"])

    def keys(self, prefix: str) -> list[str]:
        """Keys that begin with a prefix, which ends at a slash.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        return [*self.sizes(prefix)]

    def sizes(self, prefix: str) -> dict[str, int]:
        """Sizes of the objects whose keys begin with a prefix, which ends at a slash [bytes].

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        with _asking():
            found = (meta for page in self._store.list(prefix) for meta in page)
            return {meta["path"]: meta["size"] for meta in found}

    def delete(self, keys: Iterable[str]) -> None:
        """Delete objects, whether they are there or not.

        Raises:
            StoreUnavailableError: The store does not answer.
        """
        if found := [*keys]:
            with _asking():
                self._store.delete(found)


@contextmanager
def _asking() -> Iterator[None]:
    from obstore.exceptions import BaseError

    try:
        yield
    except BaseError as error:
        raise StoreUnavailableError(
            "The object store does not answer.",
            f"Check that it runs, and the AWS_* variables: {_first_line(error)}",
        ) from error


def _first_line(error: Exception) -> str:
    return f"{error}".strip().partition("\n")[0][:300]
