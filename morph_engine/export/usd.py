"""USD: an animation of points, surfaces or a moving mesh, with a time sample per frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from morph_engine import srgb
from morph_engine.export.format import Format
from morph_engine.export.gltf import ROUGHNESS
from morph_engine.optional_packages import load
from morph_engine.results.selection import Selection, Snapshot, known_points
from morph_engine.results.tracked_surface import track_surface

MATERIAL = "/morph/material"

Floats = npt.NDArray[np.float64]

FRAMES_PER_SECOND = 24.0

METERS_PER_UNIT = 1.0
"""A unit of the user's files is a metre, as in glTF and Blender; the usual centimetre would arrive
a hundred times smaller there."""


def write(selection: Selection, path: Path) -> None:
    """Write the frames as time samples; arguments as for `Format.write`."""
    Usd, UsdGeom = (load(f"pxr.{name}", extra="usd", purpose="USD") for name in ("Usd", "UsdGeom"))
    # the library goes by the name's ending, and the file is written under a temporary name
    stage = Usd.Stage.CreateInMemory()
    stage.SetStartTimeCode(min(selection.frames))
    stage.SetEndTimeCode(max(selection.frames))
    rate = selection.fps or FRAMES_PER_SECOND
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, METERS_PER_UNIT)
    root = UsdGeom.Xform.Define(stage, "/morph")
    stage.SetDefaultPrim(root.GetPrim())
    if selection.tracked:
        _tracked(UsdGeom, stage, root, selection)
    elif selection.surface:
        shape = UsdGeom.Mesh.Define(stage, "/morph/surface")
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        for snapshot in selection.snapshots():
            _sample(UsdGeom, shape, snapshot)
    else:
        shape = UsdGeom.Points.Define(stage, "/morph/particles")
        shape.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        for snapshot in selection.snapshots():
            _sample(UsdGeom, shape, snapshot)
    _wear_colors(UsdGeom, stage)
    layer = stage.GetRootLayer()
    final = path.with_name(path.name + ".usdc")
    try:
        if not layer.Export(str(final)):
            raise OSError(None, "USD refuses to write it")
        final.replace(path)
    finally:
        final.unlink(missing_ok=True)


def _tracked(UsdGeom: Any, stage: Any, root: Any, selection: Selection) -> None:
    """A mesh whose triangles have no time samples; two where the topology changes."""
    surface = track_surface(selection)
    if surface.changes_at is not None:
        root.GetPrim().SetCustomDataByKey("topologyChangesAtFrame", surface.changes_at)
    for mesh, name in zip(surface.meshes, ("surface", "surface_after"), strict=False):
        shape = UsdGeom.Mesh.Define(stage, f"/morph/{name}")
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        _triangles(shape, mesh.faces)
        for frame, vertices, normals in zip(mesh.frames, mesh.vertices, mesh.normals, strict=True):
            _vertices(UsdGeom, shape, vertices, normals, frame)
        if mesh.colors is not None:
            for frame, colors in zip(mesh.frames, mesh.colors, strict=True):
                _colors(UsdGeom, shape, colors, frame)
        if surface.changes_at is not None:
            second = mesh is surface.meshes[1]
            shown, hidden = UsdGeom.Tokens.inherited, UsdGeom.Tokens.invisible
            visibility = shape.CreateVisibilityAttr()
            visibility.Set(hidden if second else shown, min(selection.frames))
            visibility.Set(shown if second else hidden, surface.changes_at)


def _sample(UsdGeom: Any, shape: Any, snapshot: Snapshot) -> None:
    """Set one frame."""
    Sdf, Vt = (load(f"pxr.{name}", extra="usd", purpose="USD") for name in ("Sdf", "Vt"))
    time = snapshot.frame
    _vertices(UsdGeom, shape, snapshot.vertices, snapshot.normals, time)
    if snapshot.faces is None:
        shape.CreateWidthsAttr().Set([snapshot.spacing], time)
    else:
        _triangles(shape, snapshot.faces, time)
    if snapshot.colors is not None:
        _colors(UsdGeom, shape, snapshot.colors, time)
    variables = UsdGeom.PrimvarsAPI(shape)
    for name, values in snapshot.fields.items():
        variable = variables.CreatePrimvar(
            name, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex
        )
        variable.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(values)), time)


def _vertices(UsdGeom: Any, shape: Any, positions: Floats, normals: Floats, time: int) -> None:
    """Set positions, their bounds and, if there are any, normals of one frame.

    Raises:
        MeshError: All its particles are lost.
    """
    Vt = load("pxr.Vt", extra="usd", purpose="USD")
    vertices = positions.astype(np.float32)
    known = known_points(vertices, time)
    shape.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(vertices), time)
    extent = np.stack([vertices[known].min(axis=0), vertices[known].max(axis=0)])
    shape.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), time)
    if len(normals):
        outward = Vt.Vec3fArray.FromNumpy(normals.astype(np.float32))
        shape.CreateNormalsAttr().Set(outward, time)
        shape.SetNormalsInterpolation(UsdGeom.Tokens.vertex)


def _colors(UsdGeom: Any, shape: Any, colors: srgb.Bytes, time: int) -> None:
    """Set colours of one frame, in linear light as USD wants them."""
    Vt = load("pxr.Vt", extra="usd", purpose="USD")
    variable = shape.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    light = srgb.from_bytes(colors).astype(np.float32)
    variable.Set(Vt.Vec3fArray.FromNumpy(light), time)


def _wear_colors(UsdGeom: Any, stage: Any) -> None:
    """Bind what has colours to a material that reads them, as renderers ask for one."""
    Sdf, UsdShade = (
        load(f"pxr.{name}", extra="usd", purpose="USD") for name in ("Sdf", "UsdShade")
    )
    shapes = [prim for prim in stage.Traverse() if _has_colors(UsdGeom, prim)]
    if not shapes:
        return
    types = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, MATERIAL)
    reader = UsdShade.Shader.Define(stage, f"{MATERIAL}/colors")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", types.String).Set("displayColor")
    color = reader.CreateOutput("result", types.Float3)
    surface = UsdShade.Shader.Define(stage, f"{MATERIAL}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("diffuseColor", types.Color3f).ConnectToSource(color)
    surface.CreateInput("roughness", types.Float).Set(ROUGHNESS)
    outcome = surface.CreateOutput("surface", types.Token)
    material.CreateSurfaceOutput().ConnectToSource(outcome)
    for prim in shapes:
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def _has_colors(UsdGeom: Any, prim: Any) -> bool:
    return bool(prim.IsA(UsdGeom.Gprim) and UsdGeom.Gprim(prim).GetDisplayColorPrimvar().HasValue())


def _triangles(shape: Any, faces: npt.NDArray[np.int32], time: int | None = None) -> None:
    """Set the triangles of one frame, or of all."""
    Vt = load("pxr.Vt", extra="usd", purpose="USD")
    at = () if time is None else (time,)
    counts = np.full(len(faces), 3, np.int32)
    shape.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), *at)
    corners = np.ascontiguousarray(faces.reshape(-1))
    shape.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners), *at)


FORMAT = Format(
    name="usd",
    suffix=".usdc",
    media_type="model/vnd.usd",
    kind="sequence",
    carries=frozenset({"points", "surface", "fields", "tracked"}),
    extra="usd",
    description="An animation of points or surfaces; Blender, Houdini, Omniverse, usdview",
    write=write,
)
