"""What a user meets first: `import morph_engine`."""

import doctest
import subprocess
import sys

import pytest

import morph_engine

HEAVY = ("taichi.lang", "scipy.spatial", "trimesh.base", "igl.pyigl_core", "matplotlib", "shapely")


def imported_by(statement: str) -> set[str]:
    """Modules that a fresh process holds after a statement."""
    program = f"import sys; {statement}; print(*sys.modules)"
    printed = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    return set(printed.stdout.decode().split())


def test_the_namespace_shows_what_there_is() -> None:
    """Names that are imported on first use are listed before it."""
    expected = {"morph", "configure", "Trajectory", "metrics", "methods", "Mesh", "load_mesh"}
    assert expected | {"Frame", "MorphConfig", "MorphError"} == set(dir(morph_engine))
    assert all(getattr(morph_engine, name) for name in dir(morph_engine))


def test_importing_the_package_imports_nothing_heavy() -> None:
    """Not even NumPy; and `morph` itself needs neither Taichi nor what reads meshes."""
    assert "numpy" not in imported_by("import morph_engine")
    assert not imported_by("from morph_engine import morph").intersection(HEAVY)


@pytest.mark.usefixtures("float32_device")
def test_the_example_of_the_package_runs() -> None:
    """What the docstring promises is what comes out."""
    outcome = doctest.testmod(morph_engine)
    assert outcome.attempted == 3
    assert outcome.failed == 0
