"""How numbers are written for people."""

import pytest

from chamfer_morph.cli.tables import format_duration, format_size, print_settings
from morph_engine.config import setting_fields
from morph_engine.errors import ConfigError
from morph_engine.presets import configure


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (7.4, "0:07"), (760, "12:40"), (3723, "1:02:03")]
)
def test_format_duration(seconds, text):
    """Minutes and seconds, with hours when there are any."""
    assert format_duration(seconds) == text


def test_format_size():
    """Megabytes below one gigabyte, gigabytes from there."""
    assert (format_size(512e6), format_size(1.34e9)) == ("512 MB", "1.3 GB")


def test_every_setting_is_listed_with_its_meaning(capsys):
    """`morph presets fast` leaves out no field, and brackets in a meaning survive."""
    print_settings(configure())
    listed = capsys.readouterr().out
    for path, field in setting_fields("flow").items():
        assert path in listed
        assert (field.description or "") in listed


def test_an_unknown_section_names_the_known_ones():
    """The remedy of a mistyped section lists them."""
    with pytest.raises(ConfigError, match="grid, sampling, stopping, material"):
        print_settings(configure(), section="nope")
