"""Records of version 0.1.0, whose digests cover its configuration.

What it left out of a digest were the sections that a kind of method did not read.
"""

from __future__ import annotations

import json

from chamfer_morph.reproduction.meshes import MeshFolder
from chamfer_morph.reproduction.runs.run import CONTROLLED_METHODS, Run, digest
from chamfer_morph.reproduction.runs.store import Record, Store
from morph_engine.config.version_0_1 import is_old

_OF_POINTS = {"points", "regularisers", "density", "basis"}
_OF_CONTROL = {"smoothing", "adjoint", "grid_loss", "chamfer"}
_OF_MATTER = {"material", "time"}
_OF_ONE = {"transport": "transport", "swd": "sliced", "sinkhorn": "entropy"}


def find_old_record(run: Run, store: Store, meshes: MeshFolder) -> Record | None:
    """The record of a completed run, with the same configuration and shapes, of version 0.1.0.

    Returns:
        The record in today's form; None if there is none, or if it is of something else.

    Raises:
        MorphError: A mesh is missing or a setting unknown.
    """
    try:
        document = json.loads(store.record_path(run).read_bytes())
        stored = document["config"]
        if not stored or not is_old(stored):  # a run that is not complete has none
            return None
        known = {name: value for name, value in stored.items() if name not in _left_out(run.method)}
        shapes = [meshes.digest(name) for name in run.shapes]
        if document["digest"] != digest({"config": known, "shapes": shapes}):
            return None
        record = Record.model_validate(document | {"run": run, "digest": run.digest(meshes)})
    except (OSError, ValueError, LookupError, TypeError):
        return None
    if not record.is_complete or record.config is None:
        return None
    config = run.config()
    return record if record.config.model_copy(update={"preset": config.preset}) == config else None


def _left_out(method: str) -> set[str]:
    of_others = {section for name, section in _OF_ONE.items() if name != method}
    if method == "transport":
        return {"preset", *of_others, *_OF_POINTS, *_OF_CONTROL}
    if method in CONTROLLED_METHODS:
        return {"preset", *of_others, *_OF_POINTS}
    return {"preset", *of_others, *_OF_MATTER, *_OF_CONTROL}
