"""What an engine process tells its worker."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.patience import PATIENCE

PRINTING = """
from chamfer_morph.worker import engine_process
engine_process._messages = engine_process.keep_output()
print(0.12)
engine_process._send("frame", {"frame": 1})
"""


def test_what_a_method_prints_is_no_message() -> None:
    """A number alone is JSON, too; it goes where errors go, which is the log of the job."""
    engine = subprocess.run(
        [sys.executable, "-c", PRINTING],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert json.loads(engine.stdout) == {"type": "frame", "data": {"frame": 1}}
    assert "0.12" in engine.stderr
