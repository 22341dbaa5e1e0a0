"""Which changes of the code make a run of a method another one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import morph_engine
from morph_engine import methods
from morph_engine.code_digest import code_digest, code_files
from morph_engine.errors import ConfigError
from morph_engine.morphing import morph
from morph_engine.presets import configure

PACKAGE = Path(morph_engine.__file__).parent
METHODS = ("dco", "sinkhorn", "transport", "flow")
PROGRAM = f"""
import json
from morph_engine.code_digest import code_digest
print(json.dumps({{method: code_digest(method) for method in {METHODS}}}))
"""
KEEPING = """
import sys
from pathlib import Path
from morph_engine import kept_results
kept_results.keep_in(Path(sys.argv[1]))
"""

Digests = dict[str, str]


def digests_of(folder: Path, program: str = PROGRAM) -> Digests:
    """Digests by method of the engine that lies in a folder, which are kept beside it, or not."""
    process = subprocess.run(
        [sys.executable, "-c", program, str(folder / "kept")],
        env=os.environ | {"PYTHONPATH": str(folder)},
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return json.loads(process.stdout)


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., set[str]]:
    """Tells which methods have another digest after a file of the engine is changed."""
    folder = tmp_path_factory.mktemp("engine")
    shutil.copytree(PACKAGE, folder / "morph_engine", ignore=shutil.ignore_patterns("__pycache__"))
    before = digests_of(folder)
    assert before == {method: code_digest(method) for method in METHODS}

    def compare(name: str, change: Callable[[str], str]) -> set[str]:
        path = folder / "morph_engine" / name
        source = path.read_bytes()
        other = change(source.decode()).encode()
        assert other != source
        path.write_bytes(other)
        try:
            after = digests_of(folder)
        finally:
            path.write_bytes(source)
        return {method for method in METHODS if after[method] != before[method]}

    return compare


@pytest.mark.parametrize(
    ("name", "methods_of_it"),
    [
        ("methods/dco.py", {"dco"}),
        ("methods/transport.py", {"transport"}),
        ("smoothstep.py", set(METHODS)),  # colours of a result are blended by it, too
        ("losses/sinkhorn.py", {"sinkhorn"}),
        ("mpm/constitutive.py", {"transport", "flow"}),
        ("metrics/volume.py", set(METHODS)),
        ("rendering/rasterizer.py", set()),
        ("export/ply.py", set()),
        ("export/html.py", set()),  # by which a result shows itself in a notebook
        ("results/tracked_surface.py", set()),
    ],
)
def test_a_change_counts_for_the_methods_that_compute_with_it(changed, name, methods_of_it):
    """A statement more in a file."""
    assert changed(name, lambda text: f"{text}\nADDED = 1\n") == methods_of_it


def test_what_is_no_code_does_not_count(changed):
    """Comments, blank lines, docstrings and line ends."""

    def reworded(text):
        text = text.replace("class Dco(", "# a comment\n\n\nclass Dco(")
        text = text.replace(
            '"""Chamfer distance and local', '"""Both the Chamfer distance and local'
        )
        return text.replace("\n", "\r\n")

    assert changed("methods/dco.py", reworded) == set()


@pytest.mark.parametrize("method", ["dco", "joint", "transport"])
def test_every_function_that_a_run_calls_counts(method):
    """No file of the engine is missed, however its modules import each other."""
    methods.names()  # which imports every method
    called = set()

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_name != "<module>":
            called.add(Path(frame.f_code.co_filename))

    config = configure(
        "fast",
        {"method": method, "sampling.points_per_cell_edge": 1, "frames": 2}
        | ({"chamfer.start_frame": 0} if method == "joint" else {}),
    )
    frames = morph("sphere", "star", config, device="cpu", threads=1)
    sys.setprofile(note)
    try:
        assert len(list(frames)) == 2
    finally:
        sys.setprofile(None)
    of_engine = {path for path in called if path.is_relative_to(PACKAGE)}
    assert len(of_engine) > 10
    assert of_engine <= set(code_files(method).values())


def test_kept_digests_are_those_of_the_code(tmp_path: Path):
    """When they are found, when they are read, and after a change of any file."""
    shutil.copytree(PACKAGE, tmp_path / "morph_engine", ignore=shutil.ignore_patterns("__p*"))
    first, second = (digests_of(tmp_path, KEEPING + PROGRAM) for _ in range(2))
    assert first == second == {method: code_digest(method) for method in METHODS}
    with (tmp_path / "morph_engine" / "morphing.py").open("a") as file:
        file.write("CHANGED = 1\n")
    assert not set(digests_of(tmp_path, KEEPING + PROGRAM).values()) & set(first.values())


def test_an_unknown_method_is_refused():
    """As everywhere."""
    with pytest.raises(ConfigError, match="'dco'"):
        code_digest("doc")
