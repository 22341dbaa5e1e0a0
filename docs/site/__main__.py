"""Build the site, and refuse what is wrong: a dead link, a page without a place, odd markup.

python -m docs.site --to site
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from sphinx.cmd.build import main as sphinx_build

from docs.site.sources import write_sources

SITE = Path(__file__).resolve().parent


def main() -> int:
    """Read the command line and build; the exit status of Sphinx."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.site", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--to", type=Path, default=Path("site"), help="folder of the site")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sources, doctrees = Path(folder, "docs"), Path(folder, "doctrees")
        write_sources(sources)
        strictly = ("--quiet", "--fail-on-warning", "--keep-going")
        return sphinx_build(
            [*strictly, "-c", str(SITE), "-d", str(doctrees), str(sources), str(arguments.to)]
        )


if __name__ == "__main__":
    sys.exit(main())
