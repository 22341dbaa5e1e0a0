"""Thousands of requests that schemathesis makes up from the committed contract, on a real service.

    python -m benchmarks.api_fuzzing [--examples 200] [--database postgresql://...]

No answer may be a 5xx or depart from the contract. The requests carry an admin key, so that none
of those that make keys can shut the others out; revoking keys is left out for the same reason.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.service.local_service import LocalService

CONTRACT = Path(__file__).resolve().parents[1] / "openapi"


def main() -> int:
    """Run all of it.

    Returns:
        Exit status of schemathesis.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.api_fuzzing", description=__doc__)
    parser.add_argument("--examples", type=int, default=200, help="for each operation and phase")
    parser.add_argument("--database", default="", help="URL of an empty Postgres database")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--phases", default="examples,coverage,fuzzing,stateful", help="which")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="morph-contract-") as folder:
        service = LocalService(Path(folder), options.database)
        key = service.add_key("root", "admin")
        with service.served(1) as (api, _):
            return subprocess.run(
                [
                    Path(sys.executable).with_name("schemathesis"),
                    "--config-file", CONTRACT / "schemathesis.toml",
                    "run", CONTRACT / "openapi.json",
                    "--url", str(api.base_url),
                    "--header", f"Authorization: {key['Authorization']}",
                    "--exclude-operation-id", "revokeKey",
                    "--max-examples", str(options.examples),
                    "--seed", str(options.seed),
                    "--phases", options.phases,
                ],
                check=False, cwd=folder,
            ).returncode  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
