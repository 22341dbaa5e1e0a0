"""One run in a process of its own, with the arguments RUN RESULTS MESHES THREADS.

RUN is a `Run` as JSON. An unfinished run goes on after its last finished frame, if the same code
began it. The process ends when its standard input does, which is when whoever started it is gone.
"""

from __future__ import annotations

import sys
from pathlib import Path

from chamfer_morph.reproduction.meshes import MeshFolder
from chamfer_morph.reproduction.runs.run import Run
from chamfer_morph.reproduction.runs.store import Record, Store, record_from_result
from morph_engine import morphing
from morph_engine.child_process import exit_with_parent
from morph_engine.errors import MorphError, ResultError
from morph_engine.results.provenance import Provenance, provenance_by_now
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import Trajectory


def compute(run: Run, store: Store, meshes: MeshFolder, *, threads: int) -> Record:
    """Compute a run on the CPU, store its record and return it.

    Raises:
        MorphError: It cannot be computed.
    """
    digest = run.digest(meshes)
    wanted = morphing.prepare(meshes.locate(run.source), meshes.locate(run.target), run.config())
    out = store.result_path(run)
    out.parent.mkdir(parents=True, exist_ok=True)
    provenance = store.progress(run, digest)
    if provenance.code != run.code:  # nobody knows which code left what is there
        provenance = Provenance()
        out.unlink(missing_ok=True)
    if not _is_result_of(out, wanted):
        resume = provenance.code != "" and _is_unfinished_run_of(out, wanted)
        earlier = provenance if resume else Provenance()
        for _ in morphing.run(
            wanted, device="cpu", threads=threads, out=out, resume=resume, overwrite=not resume
        ):
            store.save_progress(run, digest, provenance_by_now(run.method).after(earlier))
        provenance = provenance_by_now(run.method).after(earlier)
    with Trajectory(out) as result:
        record = record_from_result(run, digest, result, provenance)
    store.save(record)
    return record


def _is_unfinished_run_of(path: Path, wanted: RunRecord) -> bool:
    """Tell whether an earlier attempt at the same run left whole frames to go on from."""
    try:
        with Spool.open(path, wanted, writable=False):
            return True
    except ResultError:
        return False


def _is_result_of(path: Path, wanted: RunRecord) -> bool:
    """Tell whether a complete result of the same run is there already."""
    try:
        with Trajectory(path) as result:
            return result.status == "complete" and result.run.document() == wanted.document()
    except ResultError:
        return False


def main() -> int:
    """Read the command line and compute; a run that cannot be computed is noted in the store."""
    exit_with_parent(1)
    text, results, folder, threads = sys.argv[1:]
    run = Run.model_validate_json(text)
    store, meshes = Store(Path(results)), MeshFolder(Path(folder))
    try:
        compute(run, store, meshes, threads=int(threads))
    except MorphError as error:
        store.save_failure(run, run.digest(meshes), str(error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
