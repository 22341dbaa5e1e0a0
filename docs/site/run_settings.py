"""The reference of a run's settings, from the configuration's own fields."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pydantic.fields import FieldInfo

from chamfer_morph.cli.tables import settings_rows
from docs.site.markdown import code, row
from morph_engine.config import MorphConfig
from morph_engine.config.settings import option_fields, shared_fields
from morph_engine.methods import names, options_of
from morph_engine.presets import configure

INTRODUCTION = """\
# Settings of a run

`--set PATH=VALUE` on the command line, `configure("fast", {path: value})` in Python and `overrides`
in a request of the service take these paths. Values are those of the preset `fast`;
[presets](../presets.md) tells what the others are for.
"""


def page() -> str:
    """What all methods share, then the options of each."""
    lines = [INTRODUCTION, "## Of every method", ""]
    lines += _table(configure("fast"), shared_fields())
    for name in names():
        lines += [f"## `{name}`", "", options_of(name).summary(), ""]
        lines += _table(configure("fast", {"method": name}), option_fields(name))
    return "\n".join(lines)


def _table(config: MorphConfig, fields: Mapping[str, FieldInfo]) -> Iterator[str]:
    yield from (row("setting", "value", "allowed", "meaning"), row(*["---"] * 4))
    for path, value, allowed, meaning in settings_rows(config, fields):
        yield row(code(path), code(value), code(allowed), meaning)
    yield ""
