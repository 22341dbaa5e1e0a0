"""Sphinx's configuration: CommonMark by MyST, docstrings by autodoc, looks by Furo."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.metadata import version as version_of
from inspect import signature
from typing import Any

from sphinx.util.inspect import stringify_signature

from chamfer_morph import schemas
from docs.site.library import PAGES

project = "chamfer-morph"
version = release = version_of("chamfer-morph")
smartquotes_action = "D"  # dashes, and no quotes
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4
highlight_language = "text"
default_role = "code"  # docstrings write names as Markdown does

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
add_module_names = False
napoleon_attr_annotations = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

html_theme = "furo"
pygments_dark_style = "monokai"
html_title = "chamfer-morph"
html_logo = html_favicon = "static/logo.svg"
html_static_path = ["static"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f4e79", "color-brand-content": "#1f5f9e"},
    "dark_css_variables": {"color-brand-primary": "#8fc1f0", "color-brand-content": "#8fc1f0"},
}

BAR = re.compile(r"(?<![`|])\|(?=[^|\s])")
"""A bar before a word, as in |x|: in reStructuredText the beginning of a substitution."""

SCHEMA = re.compile(rf"(?<![.\w])({'|'.join(schemas.__all__)})\b")
"""A document of the service: its `Mesh` is not the engine's."""


def setup(app: Any) -> None:
    """Import what is documented as programs do; autodoc would, as type checkers see it."""
    for _, modules in PAGES.values():
        for module in modules:
            import_module(module)
    app.connect("autodoc-process-docstring", _keep_bars)
    app.connect("autodoc-skip-member", _skip_data)
    app.connect("autodoc-process-signature", _as_written)


def _keep_bars(
    _app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    lines[:] = [BAR.sub(r"\\|", line) for line in lines]


def _skip_data(_app: Any, kind: str, _name: str, member: Any, skip: bool, _options: Any) -> bool:
    """Whether to leave a member out: constants of a module are its own matter."""
    return skip or (kind == "module" and not callable(member))


def _as_written(
    _app: Any, kind: str, name: str, member: Any, _options: Any, shown: str | None, returns: str
) -> tuple[str, ...] | None:
    """A signature with types as the source has them, not what they stand for."""
    if shown is None:
        return None
    written = signature(member)
    own = [each for name, each in written.parameters.items() if name not in ("self", "cls")]
    if not all(isinstance(each.annotation, str) for each in own):
        return None
    result = written.return_annotation
    texts = (
        stringify_signature(written.replace(parameters=own), show_return_annotation=False),
        result if isinstance(result, str) and kind != "class" else returns,
    )
    if name.startswith("chamfer_morph.client."):
        texts = tuple(SCHEMA.sub(r"schemas.\1", text or "") for text in texts)
    return texts
