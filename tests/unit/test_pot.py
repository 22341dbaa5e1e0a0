"""POT comes without its sample data, which are there for who asks."""

import subprocess
import sys

CODE = """
import sys
from morph_engine import pot
ot = pot.load()
assert "scipy.stats" not in sys.modules
assert callable(ot.emd) and callable(ot.gromov.fused_gromov_wasserstein)
samples = ot.datasets
for _ in range(2):
    assert abs(samples.make_1D_gauss(5, 2, 1).sum() - 1) < 1e-12
from ot.datasets import make_2D_samples_gauss
"""


def test_sample_data_are_imported_when_they_are_used() -> None:
    """As an attribute of the package, and by their name."""
    subprocess.run([sys.executable, "-c", CODE], check=True)
