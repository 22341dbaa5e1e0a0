"""Plant faults into the queue, one at a time, and see which of them no test finds.

`python -m benchmarks.mutation [FILE ...]`. cosmic-ray changes an operator, a number or a condition
in a copy of the tree, and runs what tests the file. docs/faults.md judges what has survived.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOOL = ("uv", "tool", "run", "--from", "cosmic-ray==8.7.0")
TIMEOUT_SECONDS = 180.0

PYTEST = "{python} -m pytest -x -q -p no:cacheprovider"
HISTORIES = "{python} -m benchmarks.histories --count 60"
OWN_QUEUE = (
    "tests/unit/test_dbos_adapter.py tests/integration/test_own_queue.py "
    "tests/integration/api/test_api_queue.py"
)
QUEUE = f"{OWN_QUEUE} tests/integration/api/test_api_jobs.py"

TESTS = {
    "worker/job_state.py": f"{PYTEST} tests/unit/test_job_state.py",
    "worker/places.py": f"{PYTEST} tests/unit/test_places.py",
    "worker/own_queue.py": f"sh -c '{HISTORIES} && {PYTEST} {OWN_QUEUE}'",
    "worker/queue.py": f"sh -c '{HISTORIES} && {PYTEST} {QUEUE}'",
}
"""What finds the faults in a file."""

LEFT_OUT = (
    # `is` in place of `==`, `**` in place of `|` and the like fail at once wherever they are run
    r"core/ReplaceBinaryOperator_(?!BitOr_BitAnd|BitAnd_BitOr|Add_Sub|Sub_Add).*",
    r"core/ReplaceComparisonOperator_"
    r"(?!Eq_NotEq|NotEq_Eq|Gt_GtE|Gt_Lt$|GtE_Gt$|Lt_LtE|Lt_Gt$|LtE_Lt$|Is_IsNot|IsNot_Is).*",
    r"core/ReplaceUnaryOperator_(?!USub_UAdd|Delete_Not).*",
    r"core/ExceptionReplacer",  # names an exception that there is not
)
"""Operators of cosmic-ray that tell nothing."""


def main() -> int:
    """Plant faults in some files and print those that survive.

    Returns:
        Exit status: 0 where each was found.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutation", description=__doc__)
    parser.add_argument("file", nargs="*", help=f"of {', '.join(TESTS)}; all without")
    files = parser.parse_args().file or [*TESTS]
    survived = 0
    with tempfile.TemporaryDirectory(prefix="morph-mutation-") as name:
        tree = Path(name) / "tree"
        copy_tree(tree)
        for file in files:
            found = [*results(tree, file)]
            survivors = [diff for killed, diff in found if not killed]
            survived += len(survivors)
            print(f"{file}: {len(found)} faults, {len(survivors)} survive", flush=True)
            for diff in survivors:
                print(f"\n{diff}", flush=True)
    return min(survived, 1)


def copy_tree(folder: Path) -> None:
    """Copy what git tracks, as it is now."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    for name in filter(None, listed.split("\0")):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_file():
            shutil.copy2(ROOT / name, target)


def results(tree: Path, file: str) -> Iterator[tuple[bool, str]]:
    """Plant faults in a file of a tree; yields whether each was found, and what it is."""
    config, session = tree / "mutation.toml", tree / "mutation.sqlite"
    command = TESTS[file].replace("{python}", sys.executable)
    config.write_text(
        f"[cosmic-ray]\nmodule-path = {json.dumps(file)}\ntimeout = {TIMEOUT_SECONDS}\n"
        f'test-command = {json.dumps(command)}\ndistributor.name = "local"\n'
        f"[cosmic-ray.filters.operators-filter]\nexclude-operators = {json.dumps(LEFT_OUT)}\n",
        encoding="utf-8",
    )
    run(tree, "cosmic-ray", "baseline", config)
    run(tree, "cosmic-ray", "init", config, session, "--force")
    run(tree, "cr-filter-operators", session, config)
    run(tree, "cosmic-ray", "exec", config, session)
    for line in run(tree, "cosmic-ray", "dump", session).splitlines():
        _, result = json.loads(line)
        if result["worker_outcome"] != "skipped":
            yield result["test_outcome"] != "survived", changed_lines(result["diff"])


def changed_lines(diff: str) -> str:
    """The place and the lines of a diff that differ."""
    lines = [line for line in diff.splitlines() if line[:1] in ("-", "+", "@")]
    return "\n".join(line for line in lines if not line.startswith(("---", "+++")))


def run(tree: Path, program: str, *arguments: object) -> str:
    """Run a program of cosmic-ray in a tree; what it prints.

    Raises:
        SystemExit: It fails.
    """
    environment = os.environ | {
        "PYTHONPATH": str(tree),  # before the package as it is installed
        "PYTHONDONTWRITEBYTECODE": "1",  # which two faults within a second may share
    }
    done = subprocess.run(
        [*TOOL, program, *map(str, arguments)],
        cwd=tree, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        sys.exit(f"{program} {arguments[0]}: {done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
