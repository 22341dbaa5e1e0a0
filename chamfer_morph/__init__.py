"""The job server, its workers, its client and the `morph` command; the engine is `morph_engine`.

In a checkout, server, worker and the others are links to the folders beside this one, so that all
of them are installed under one name.
"""

from pathlib import Path

if not (Path(__file__).parent / "server").is_dir():  # git made no links here, as on Windows
    __path__.append(str(Path(__file__).parent.parent))
