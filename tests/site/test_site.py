"""The documentation as a site: no dead link, nothing from elsewhere, at home on desk and phone."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import unquote, urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, sync_playwright

from tests.patience import patient

pytestmark = pytest.mark.site

ROOT = Path(__file__).resolve().parents[2]
SITE = ROOT / "site"
WIDTHS = {"desk": (1400, 900), "phone": (390, 844)}
PAGES = (
    "index", "tutorial", "gallery", "method", "results/report", "reference/http",
    "reference/command_line", "reference/python/results",
)  # fmt: skip


class Reader(HTMLParser):
    """The ids of a page, where it leads to, and what it loads.

    Attributes:
        ids: Places that a link may name.
        links: Addresses that a reader may go to.
        loaded: Addresses that the browser fetches to show the page.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag says."""
        given = {name: value or "" for name, value in attrs}
        self.ids |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("canonical", "next", "prev"):
            self.loaded.append(given["href"])
        elif "src" in given:
            self.loaded.append(given["src"])


@pytest.fixture(scope="module")
def read() -> dict[Path, Reader]:
    """All pages of the built site."""
    if not (SITE / "index.html").is_file():
        pytest.fail("The site is not built. Run `make site` first.")
    return {path: Reader(path) for path in SITE.rglob("*.html")}


def test_every_document_is_a_page(read: dict[Path, Reader]) -> None:
    """Those of docs/, and those of the repository itself."""
    documents = {path.relative_to(ROOT / "docs") for path in ROOT.glob("docs/**/*.md")}
    pages = {path.relative_to(SITE).with_suffix(".md") for path in read}
    own = {Path(name) for name in ("index.md", "contributing.md", "changelog.md")}
    assert documents | own <= pages
    assert len(documents) > 25


def test_no_link_is_dead(read: dict[Path, Reader]) -> None:
    """Pages, files and places on pages; other hosts are not asked."""
    dead = []
    for page, reader in read.items():
        for link in (*reader.links, *reader.loaded):
            parts = urlsplit(link)
            if parts.scheme:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            if not target.is_file() or not is_place(unquote(parts.fragment), target, read):
                dead.append(f"{page.relative_to(SITE)}: {link}")
    assert dead == []


def is_place(name: str, target: Path, read: dict[Path, Reader]) -> bool:
    """Whether a page has a place of this name; no name is its beginning, and so is `#` alone."""
    return not name or (target in read and name in read[target].ids)


def test_nothing_is_loaded_from_elsewhere(read: dict[Path, Reader]) -> None:
    """Neither by pages nor by styles."""
    for page, reader in read.items():
        assert not [each for each in reader.loaded if re.match(r"(https?:)?//", each)], page
    for style in SITE.rglob("*.css"):
        found = re.findall(r"(?:url\(|@import)\s*['\"]?((?:https?:)?//[^'\")]+)", style.read_text())
        assert found == [], style


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium without a window."""
    path = os.environ.get("MORPH_CHROMIUM") or shutil.which("chromium")
    if path is None:
        pytest.fail("There is no chromium. Install it, or name it in MORPH_CHROMIUM.")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Where a plain file server has the site."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *arguments: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(SITE))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture
def open_page(browser: Browser, address: str) -> Iterator[Callable[..., Page]]:
    """Opens pages that may do nothing wrong and ask nobody else for anything."""
    faults: list[str] = []

    def hear(message: ConsoleMessage) -> None:
        if message.type == "error":
            faults.append(f"{message.text} at {message.location}")

    def look(request: Request) -> None:
        if not request.url.startswith((address, "data:")):
            faults.append(f"a request to {request.url}")

    def open_at(name: str, width: str = "desk", scheme: str = "light") -> Page:
        horizontal, vertical = WIDTHS[width]
        page = browser.new_page(
            viewport={"width": horizontal, "height": vertical},
            color_scheme="dark" if scheme == "dark" else "light",
        )
        patient(page)
        page.on("request", look)
        page.on("console", hear)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(f"{address}{name}.html")
        return page

    yield open_at
    assert faults == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_pages_fit(open_page: Callable[..., Page], width: str, scheme: str) -> None:
    """Nothing stands out at the side, every picture is there, and the night is dark."""
    for name in PAGES:
        page = open_page(name, width, scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= WIDTHS[width][0], name
        missing = page.evaluate(
            "[...document.images].filter(each => each.complete && !each.naturalWidth)"
            ".map(each => each.src)"
        )
        assert missing == [], name
        shade = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (int(re.findall(r"\d+", shade)[0]) < 128) == (scheme == "dark"), (name, shade)
        page.close()


def test_the_search_finds(open_page: Callable[..., Page]) -> None:
    """A word of the documents, and a function of the library."""
    page = open_page("index")
    for words, found in (("janitor", "Operating"), ("reconstruct_surface", "reconstruct_surface")):
        page.locator("input[name=q]").first.fill(words)
        page.keyboard.press("Enter")
        page.locator("#search-results a", has_text=found).first.wait_for()
