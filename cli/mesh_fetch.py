"""The paper's meshes in a folder: their originals fetched, checked, and put in place."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import httpx

from chamfer_morph.cli import interrupt
from chamfer_morph.cli.web_download import complete, discard, download, web_client
from chamfer_morph.reproduction.checksums import read_checksums, write_checksums
from chamfer_morph.reproduction.originals import RECIPES, Original, Recipe, build, write_mesh
from morph_engine.errors import MeshError, unknown_name
from morph_engine.files import acquire, file_sha256

ORIGINALS = "originals"
CHECKSUMS = "SHA256SUMS"

Origin = Literal["original", "made here", "yours"]
Checked = Literal["as known", "recorded now", ""]


@dataclass(frozen=True)
class FetchedMesh:
    """A mesh of the folder.

    Attributes:
        name: Its file name.
        origin: Whether it is made from an original, made here, or was there already, of the user's.
        original: Address of the original; empty without one.
        sha256: Digest of the original; empty without one.
        checked: Whether that digest was known before, or is recorded from now on; empty where the
            mesh was in place already.
        stands_in: Whether it is another mesh than the paper's; None of the user's own.
    """

    name: str
    origin: Origin
    original: str = ""
    sha256: str = ""
    checked: Checked = ""
    stands_in: bool | None = None


def fetch_meshes(
    folder: Path,
    names: Iterable[str] | None = None,
    *,
    place: str = "",
    checksums: Path | None = None,
    quiet: bool = False,
) -> list[FetchedMesh]:
    """Put meshes into a folder, telling on standard error what is being done; see `MeshFetch`."""
    lines = (
        "Stopped by Ctrl-C; what has been downloaded is kept.",
        "Repeat the command to continue.",
    )
    fetching = MeshFetch(
        folder, place=place, checksums=checksums, report=_ignore if quiet else _tell
    )
    with interrupt.at_interrupt(partial(interrupt.report, *lines)):
        return fetching.run(names)


def _ignore(line: str) -> None:
    pass


def _tell(line: str) -> None:
    sys.stderr.write(f"{line}\n")


class MeshFetch:
    """Puts the paper's meshes into a folder.

    Originals are kept in its folder `originals`; its list `SHA256SUMS` has the digests of
    everything that was fetched or made, against which each is checked from then on.

    Args:
        folder: Where they go; made if it does not exist.
        place: Where originals come from in place of their own addresses: an address or a folder.
        checksums: A list of digests that the originals must have.
        report: Is told what is being done, a line at a time.
        recipes: The meshes by file name, and how each is made.
    """

    def __init__(
        self,
        folder: Path,
        *,
        place: str = "",
        checksums: Path | None = None,
        report: Callable[[str], None] = _ignore,
        recipes: Mapping[str, Recipe] = RECIPES,
    ) -> None:
        self._folder = folder
        self._place = place
        self._checksums = checksums
        self._report = report
        self._recipes = recipes
        self._obtained: dict[str, Checked] = {}
        self._resources = ExitStack()

    def run(self, names: Iterable[str] | None = None) -> list[FetchedMesh]:
        """Put these meshes in place, all by default; what is there and sound stays as it is.

        Raises:
            MeshError: A name is unknown, an original cannot be had, or is not the one it should be;
                what is wrong is removed, and what broke off is kept for next time.
        """
        wanted = list(dict.fromkeys(self._recipes if names is None else names))
        for name in wanted:
            if name not in self._recipes:
                raise unknown_name("mesh", name, self._recipes, error=MeshError)
        try:
            if not self._checksums and all(map(self._is_in_place, wanted)):
                return [self._put(name, self._recipes[name]) for name in wanted]
            (self._folder / ORIGINALS).mkdir(parents=True, exist_ok=True)
            with self._resources:
                lock = acquire(self._folder / ORIGINALS / ".lock")
                if lock is None:
                    raise MeshError(
                        f"Another command is fetching into {self._folder}.", "Wait until it ends."
                    )
                self._resources.callback(lock.close)
                return [self._put(name, self._recipes[name]) for name in wanted]
        except OSError as error:
            raise MeshError(
                f"{self._folder} cannot be read or written to ({error.strerror or error}).",
                "Use --to to name a writable folder with enough space.",
            ) from error

    def _put(self, name: str, recipe: Recipe) -> FetchedMesh:
        """Put one mesh in place."""
        if self._is_yours(name):
            return FetchedMesh(name, "yours")
        original = recipe.original
        if self._checksums or not self._is_sound(name):
            file = self._obtain(original) if original else None
            if not self._is_sound(name):
                self._make(name, recipe, file)
        if original is None:
            return FetchedMesh(name, "made here", stands_in=recipe.stands_in)
        return FetchedMesh(
            name,
            "original",
            original.url,
            self._digests.get(_key(original), ""),
            self._obtained.get(original.name, ""),
            recipe.stands_in,
        )

    def _is_yours(self, name: str) -> bool:
        return name not in self._digests and (self._folder / name).exists()

    def _is_sound(self, name: str) -> bool:
        path = self._folder / name
        return path.exists() and file_sha256(path) == self._digests.get(name)

    def _is_in_place(self, name: str) -> bool:
        return self._is_yours(name) or self._is_sound(name)

    def _make(self, name: str, recipe: Recipe, file: Path | None) -> None:
        """Make a mesh and remember its digest; an original that does not serve is removed."""
        self._report(f"making {name}")
        try:
            mesh = build(name, recipe, file)
        except MeshError:
            if file is not None and recipe.original is not None:
                file.unlink()
                self._forget(_key(recipe.original))
            raise
        write_mesh(mesh, self._folder / name)
        self._remember(name, file_sha256(self._folder / name))

    def _obtain(self, original: Original) -> Path:
        """The file of an original, fetched if it is not there, with the digest that it must have.

        Raises:
            MeshError: It cannot be had, or has another digest and is gone.
        """
        target = self._folder / _key(original)
        if original.name in self._obtained:
            return target
        expected = self._expected(original)
        if target.exists() and expected not in ("", file_sha256(target)):
            self._report(f"{target} is damaged and will be fetched again")
            target.unlink()
        if not target.exists():
            part = self._fetch(original, target)
            if expected not in ("", digest := file_sha256(part)):
                discard(part)
                raise MeshError(
                    f"{original.name} is not the expected file: its SHA-256 is {digest}, not "
                    f"{expected}; it has been removed.",
                    "Repeat the command, or use another source with --from. If the author has "
                    "changed the file, give a list with its new digest as --checksums.",
                )
            complete(part, target)
        self._obtained[original.name] = "as known" if expected else "recorded now"
        self._remember(_key(original), file_sha256(target))
        return target

    def _fetch(self, original: Original, target: Path) -> Path:
        """Fetch an original from where it is to come from; the part it has become."""
        place = self._place.rstrip("/")
        if not place or place.startswith(("http://", "https://")):
            url = f"{place}/{original.name}" if place else original.url
            self._report(f"fetching {url}")
            return download(self._client, url, target)
        source = Path(place, original.name)
        if not source.is_file():
            raise MeshError(
                f"There is no {original.name} in the folder {place}.",
                f"Download it from {original.url}, or omit --from.",
            )
        self._report(f"copying {source}")
        return Path(shutil.copyfile(source, target.with_name(f"{target.name}.part")))

    def _expected(self, original: Original) -> str:
        """The digest that an original must have; empty if it is not known yet."""
        given = self._given.get(original.name, "")
        return given or self._digests.get(_key(original), "") or original.sha256

    @cached_property
    def _client(self) -> httpx.Client:
        return self._resources.enter_context(web_client())

    @cached_property
    def _given(self) -> dict[str, str]:
        """Digests of the list that the user gives, by file name without folders."""
        if self._checksums is None:
            return {}
        if not self._checksums.is_file():
            raise MeshError(f"There is no list {self._checksums}.", "Check --checksums.")
        return {Path(name).name: sha for name, sha in read_checksums(self._checksums).items()}

    @cached_property
    def _digests(self) -> dict[str, str]:
        return read_checksums(self._folder / CHECKSUMS)

    def _remember(self, name: str, digest: str) -> None:
        if self._digests.get(name) != digest:
            self._digests[name] = digest
            write_checksums(self._folder / CHECKSUMS, self._digests)

    def _forget(self, name: str) -> None:
        if self._digests.pop(name, None):
            write_checksums(self._folder / CHECKSUMS, self._digests)


def _key(original: Original) -> str:
    """The path of an original in the folder, as the list names it."""
    return f"{ORIGINALS}/{original.name}"
