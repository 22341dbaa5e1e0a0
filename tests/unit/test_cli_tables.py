"""How numbers are written for people."""

import pytest

from chamfer_morph.cli.tables import (
    format_duration,
    format_size,
    print_settings,
    print_summary,
    quality,
)
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
    with pytest.raises(ConfigError, match="grid, sampling, placement, stopping, material"):
        print_settings(configure(), section="nope")


def test_the_end_of_a_run_is_a_few_lines(capsys):
    """How good, how long, and two commands that can be pasted."""
    print_summary(
        {
            "cover": 0.977, "spill": 0.031, "rho_p05": 0.98, "rho_p95": 1.11, "escaped": 0.0,
            "frames": 40, "particle_count": 37594, "wall_s": 17.4, "cpu_s": 26.2,
            "peak_rss_mb": 420.0, "out": "my result.vtkhdf",
        }
    )  # fmt: skip
    assert capsys.readouterr().out.splitlines() == [
        "98% of the target is filled, 3% of the fill lies outside it; density 0.98 to 1.11 of an "
        "even fill's.",
        "40 frames of 37,594 particles in 0:17 (26 CPU s, 420 MB): my result.vtkhdf",
        "view it:     morph view 'my result.vtkhdf'",
        "all metrics: morph metrics 'my result.vtkhdf'",
    ]


def test_lost_particles_are_told():
    """They are no small print."""
    metrics = {"cover": 1.0, "spill": 0.0, "rho_p05": 1.0, "rho_p95": 1.0, "escaped": 3.0}
    assert quality(metrics).endswith("3 particles left the domain.")
