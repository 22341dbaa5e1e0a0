"""Landmarks as a user types or stores them."""

import json

import pytest

from chamfer_morph.cli.arguments import read_landmarks
from morph_engine.errors import ConfigError
from morph_engine.presets import configure

PAIR = {"source": [0.0, -1.0, 2.5], "target": [3.0, 4.0, -5e-1]}


def test_landmarks_are_read_from_text_and_file(tmp_path):
    """Those of the file come first; without any there are none."""
    file = tmp_path / "landmarks.json"
    file.write_text(json.dumps([PAIR]))
    assert read_landmarks([], None) is None
    assert read_landmarks(["0,-1,2.5:3,4,-.5"], None) == [PAIR]
    other = {"source": [1.0, 1.0, 1.0], "target": [2.0, 2.0, 2.0]}
    assert read_landmarks(["1,1,1:2,2,2"], file) == [PAIR, other]


@pytest.mark.parametrize("text", ["0,1,2", "0,1,2:", "0,1,2:3,4,5:6,7,8", "a,b,c:0,0,0"])
def test_text_that_is_no_pair_is_refused(text):
    """The message shows how to write one."""
    with pytest.raises(ConfigError, match="not a pair of points") as caught:
        read_landmarks([text], None)
    assert "--landmark 0,1,2:3,4,5" in caught.value.remedy


def test_a_file_that_holds_none_is_refused(tmp_path):
    """Not JSON, or not there."""
    file = tmp_path / "landmarks.json"
    with pytest.raises(ConfigError, match="is not a file of landmarks"):
        read_landmarks([], file)
    file.write_text("x,y,z")
    with pytest.raises(ConfigError, match="is not a file of landmarks"):
        read_landmarks([], file)


@pytest.mark.parametrize("pair", [{"source": [0, 1], "target": [0, 0, 0]}, {"source": [0, 1, 2]}])
def test_the_configuration_judges_pairs(pair):
    """A point has three coordinates, and a pair two points."""
    with pytest.raises(ConfigError, match="landmarks"):
        configure(overrides={"method": "flow", "landmarks": [pair]})
