"""USD: an animation of points or surfaces, with a time sample per frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from morph_engine.export.format import Format
from morph_engine.optional_packages import load
from morph_engine.results.selection import Selection, Snapshot

FRAMES_PER_SECOND = 24.0


def write(selection: Selection, path: Path) -> None:
    """Write the frames as time samples; arguments as for `Format.write`."""
    Usd, UsdGeom = (load(f"pxr.{name}", extra="usd", purpose="USD") for name in ("Usd", "UsdGeom"))
    # the library goes by the name's ending, and the file is written under a temporary name
    stage = Usd.Stage.CreateInMemory()
    stage.SetStartTimeCode(selection.frames[0])
    stage.SetEndTimeCode(selection.frames[-1])
    stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    root = UsdGeom.Xform.Define(stage, "/morph")
    stage.SetDefaultPrim(root.GetPrim())
    kind = UsdGeom.Mesh if selection.surface else UsdGeom.Points
    shape = kind.Define(stage, "/morph/" + ("surface" if selection.surface else "particles"))
    if selection.surface:
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    else:
        shape.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    for snapshot in selection.snapshots():
        _sample(UsdGeom, shape, snapshot)
    layer = stage.GetRootLayer()
    final = path.with_name(path.name + ".usdc")
    try:
        if not layer.Export(str(final)):
            raise OSError(None, "USD refuses to write it")
        final.replace(path)
    finally:
        final.unlink(missing_ok=True)


def _sample(UsdGeom: Any, shape: Any, snapshot: Snapshot) -> None:
    """Set one frame."""
    Sdf, Vt = (load(f"pxr.{name}", extra="usd", purpose="USD") for name in ("Sdf", "Vt"))
    time = snapshot.frame
    vertices = snapshot.vertices.astype(np.float32)
    shape.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(vertices), time)
    known = np.isfinite(vertices).all(axis=1)
    extent = np.stack([vertices[known].min(axis=0), vertices[known].max(axis=0)])
    shape.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), time)
    if snapshot.faces is None:
        shape.CreateWidthsAttr().Set([snapshot.spacing], time)
    else:
        counts = np.full(len(snapshot.faces), 3, np.int32)
        shape.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), time)
        corners = np.ascontiguousarray(snapshot.faces.reshape(-1))
        shape.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners), time)
    variables = UsdGeom.PrimvarsAPI(shape)
    for name, values in snapshot.fields.items():
        variable = variables.CreatePrimvar(
            name, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex
        )
        variable.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(values)), time)


FORMAT = Format(
    name="usd",
    suffix=".usdc",
    media_type="model/vnd.usd",
    kind="sequence",
    carries=frozenset({"points", "surface", "fields"}),
    extra="usd",
    description="An animation of points or surfaces; Blender, Houdini, Omniverse, usdview",
    write=write,
)
