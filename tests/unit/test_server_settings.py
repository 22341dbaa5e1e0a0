"""docs/settings.md names every setting with its default."""

from __future__ import annotations

from pathlib import Path

from chamfer_morph.worker.settings import Settings

PAGE = Path(__file__).resolve().parents[2] / "docs" / "settings.md"


def test_every_setting_is_documented() -> None:
    """A row for each variable with the words of its description, and none for what is gone."""
    rows = {
        row.split("|")[1].strip(): row
        for row in PAGE.read_text(encoding="utf-8").splitlines()
        if row.startswith("| `MORPH_")
    }
    assert rows.keys() == {f"`MORPH_{name.upper()}`" for name in Settings.model_fields}
    for name, field in Settings.model_fields.items():
        assert (field.description or "?") in rows[f"`MORPH_{name.upper()}`"], name
