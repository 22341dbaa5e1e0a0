"""SciPy that is imported in less time is the same SciPy, and NumPy lacks nothing afterwards."""

import subprocess
import sys

CODE = """
import sys
from morph_engine import scipy_loading
scipy_loading.shorten()
import numpy as np
import scipy.ndimage, scipy.special, scipy.spatial
assert "numpy.f2py" not in sys.modules
labels, count = scipy.ndimage.label(np.eye(3))
assert count == 3
assert scipy.special.erf(0.0) == 0.0
assert "Label features" in scipy.ndimage.label.__doc__
assert callable(np.f2py.run_main)
"""


def test_scipy_and_numpy_are_whole() -> None:
    """Functions compute and have their documentation; NumPy's compiler comes when it is used."""
    subprocess.run([sys.executable, "-c", CODE], check=True)
