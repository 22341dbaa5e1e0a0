"""The units of systemd start commands that there are, with settings that there are."""

import configparser
from pathlib import Path

import pytest
from typer.main import get_command

from chamfer_morph.cli.app import app
from chamfer_morph.worker.settings import Settings

UNITS = sorted((Path(__file__).resolve().parents[2] / "docker" / "systemd").glob("*.service"))
COMPILING = "MemoryDenyWriteExecute"
LANDLOCK = {"landlock_create_ruleset", "landlock_add_rule", "landlock_restrict_self"}


class Unit(configparser.ConfigParser):
    """A unit's file; its names are told apart by their case."""

    def optionxform(self, optionstr):
        """The name as it is."""
        return optionstr


@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_a_unit_starts_a_command_with_known_settings(path):
    """An option or a setting that is renamed would show at the first start only."""
    unit = Unit(interpolation=None)
    unit.read(path)
    service = unit["Service"]
    program, command, *arguments = service["ExecStart"].split()
    assert Path(program).name == "morph"
    group = get_command(app)
    known = group.get_command(group.make_context("morph", [], resilient_parsing=True), command)
    known.make_context(command, arguments)  # refuses what it does not know
    names = [each.partition("=")[0] for each in service["Environment"].split()]
    settings = {name.removeprefix("MORPH_").lower() for name in names if name.startswith("MORPH_")}
    assert settings and settings <= {*Settings.model_fields}
    assert COMPILING not in service  # kernels are compiled as it runs
    if "SystemCallFilter" in service:  # whose group has them only since late versions of systemd
        assert {*service["SystemCallFilter"].split()} >= LANDLOCK


def test_there_are_units_for_the_service_and_for_workers():
    """As docs/operating.md names them."""
    text = (UNITS[0].parents[2] / "docs" / "operating.md").read_text()
    assert [path.name for path in UNITS] == ["morph-worker.service", "morph.service"]
    assert all(f"docker/systemd/{path.name}" in text for path in UNITS)
