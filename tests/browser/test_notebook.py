"""A Jupyter notebook with three cells: it runs in a kernel, and its page shows a viewer."""

from __future__ import annotations

import io
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbconvert import HTMLExporter
from PIL import Image, ImageChops, ImageStat
from playwright.sync_api import Browser, Locator, Page, expect

from tests.patience import patient

pytestmark = pytest.mark.browser

NOTEBOOK = Path(__file__).parents[2] / "examples" / "morph.ipynb"
QUICK = 'configure("fast", {"frames": 6, "sampling.points_per_cell_edge": 2})'


def executed(folder: Path, *cells: str) -> nbformat.NotebookNode:
    """A notebook of these cells, run by a kernel in a folder."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    client = NotebookClient(notebook, kernel_name="python3", timeout=300)
    return client.execute(cwd=str(folder))


def picture(page: Page, canvas: Locator) -> Image.Image:
    """What is drawn, once it is at rest."""
    canvas.scroll_into_view_if_needed()
    page.wait_for_timeout(1500)
    expect(canvas).not_to_have_attribute("aria-busy", "true")
    return Image.open(io.BytesIO(canvas.screenshot())).convert("RGB")


def test_the_example_has_three_cells_and_ends_with_a_viewer(
    tmp_path: Path, browser: Browser
) -> None:
    """From the installation on; the page of the notebook needs no kernel to be turned."""
    example = nbformat.read(NOTEBOOK, as_version=4)
    assert [cell.cell_type for cell in example.cells] == ["code"] * 3
    notebook = executed(tmp_path, *(cell.source for cell in example.cells))
    assert [output.output_type for output in notebook.cells[-1].outputs] == ["display_data"]
    page_file = tmp_path / "notebook.html"
    page_file.write_text(HTMLExporter().from_notebook_node(notebook)[0], encoding="utf-8")
    page = patient(browser.new_page())
    page.goto(page_file.as_uri())
    viewer = page.frame_locator("iframe[title='heart to star']")
    expect(viewer.locator("canvas")).to_be_visible(timeout=120_000)
    expect(viewer.get_by_text("1 / 24")).to_be_visible()
    before = picture(page, viewer.locator("canvas"))
    box = viewer.locator("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 40, steps=6)
    page.mouse.up()
    after = picture(page, viewer.locator("canvas"))
    assert ImageStat.Stat(ImageChops.difference(before, after)).mean[0] > 2
    page.close()


def test_a_morph_that_was_stopped_goes_on(tmp_path: Path) -> None:
    """The cell shows all of it, and names its file."""
    notebook = executed(
        tmp_path,
        "from itertools import islice\nfrom morph_engine import configure, morph",
        f"config = {QUICK}",
        "first = list(islice(morph('sphere', 'star', config, out='a.vtkhdf'), 2))",
        "morph('sphere', 'star', config, out='a.vtkhdf', resume=True)",
    )
    (output,) = notebook.cells[-1].outputs
    assert re.fullmatch(
        r"sphere to star: 6 frames of [\d,]+ particles, in a\.vtkhdf", output.data["text/plain"]
    )
    assert (tmp_path / "a.vtkhdf").exists()


def test_what_is_wrong_is_said_in_the_cell(tmp_path: Path) -> None:
    """A shape that there is not ends the cell with the error and its remedy."""
    with pytest.raises(
        CellExecutionError, match=r"no-such-shape.*Available built-in shapes: sphere"
    ):
        executed(tmp_path, "from morph_engine import morph", "morph('no-such-shape', 'star')")
