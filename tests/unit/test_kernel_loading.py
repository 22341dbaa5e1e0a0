"""Kernels that load faster still tell where an error is, and still belong to their classes."""

import subprocess
import sys

import numpy as np
import pytest
import taichi as ti

from morph_engine import backend


@ti.kernel
def broken(values: ti.types.ndarray()):
    """Uses a name that there is none of."""
    for i in values:
        values[i] = there_is_no_such_name  # noqa: F821


def test_an_error_names_file_line_and_function():
    """So that one finds it."""
    device = backend.start("cpu")
    line = broken.__wrapped__.__code__.co_firstlineno + 4
    with pytest.raises(ti.TaichiCompilationError) as caught:
        broken(device.scalars(4))
    assert f'File "{__file__}", line {line}, in broken' in str(caught.value)
    assert "there_is_no_such_name" in str(caught.value)


def test_kernels_of_classes_are_told_from_others():
    """Methods of other packages may define them, before or after Taichi is started."""
    device = backend.start("cpu")

    @ti.data_oriented
    class Doubling:
        factor = 2

        @ti.kernel
        def apply(self, values: ti.types.ndarray()):
            for i in values:
                values[i] *= self.factor

    @ti.kernel
    def halve(values: ti.types.ndarray()):
        for i in values:
            values[i] /= 2

    values = device.upload(np.arange(5.0))
    Doubling().apply(values)
    np.testing.assert_array_equal(values.to_numpy(), 2 * np.arange(5.0))
    halve(values)
    np.testing.assert_array_equal(values.to_numpy(), np.arange(5.0))


def test_starting_imports_nothing_that_waits_for_its_first_use():
    """Taichi's decorators look for source lines, and would wake every module on their way."""
    program = (
        "import sys, lazy_loader; from morph_engine import backend;"
        "lazy_loader.load('trimesh'); lazy_loader.load('scipy');"
        "backend.start('cpu'); print({'trimesh.base', 'scipy.version'} & {*sys.modules})"
    )
    printed = subprocess.check_output([sys.executable, "-c", program], text=True)
    assert printed.strip() == "set()"
