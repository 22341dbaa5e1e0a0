"""Objects of a scene as mesh files, and an animated GLB as objects of a scene."""

from __future__ import annotations

from pathlib import Path

import bpy

KINDS = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
"""Objects that have a surface."""


def write_mesh(shape: bpy.types.Object, path: Path) -> None:
    """Write an object as a GLB, with its modifiers, where it is in the scene, y up."""
    selected, active = list(bpy.context.selected_objects), bpy.context.view_layer.objects.active
    hidden = shape.hide_get()
    shape.hide_set(False)
    bpy.ops.object.select_all(action="DESELECT")
    shape.select_set(True)
    try:
        bpy.ops.export_scene.gltf(
            filepath=str(path),
            export_format="GLB",
            use_selection=True,
            export_apply=True,
            export_yup=True,
            export_animations=False,
            export_skins=False,
            export_morph=False,
            export_cameras=False,
            export_lights=False,
        )
    finally:
        bpy.ops.object.select_all(action="DESELECT")
        for each in selected:
            each.select_set(True)
        bpy.context.view_layer.objects.active = active
        shape.hide_set(hidden)


def read_animation(path: Path, name: str) -> list[bpy.types.Object]:
    """Bring the meshes of an animated GLB into the scene, selected, as z up."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path))
    new = [each for each in bpy.data.objects if each not in before]
    for each in new:
        each.name = name
    return new


def let_play(objects: list[bpy.types.Object]) -> None:
    """Make the scene's frame range hold the animation, from its start."""
    scene = bpy.context.scene
    ends = [action.frame_range for each in objects for action in _actions(each)]
    if ends:
        scene.frame_start = int(min(first for first, _ in ends))
        scene.frame_end = max(round(max(last for _, last in ends)), scene.frame_start + 1)
        scene.frame_set(scene.frame_start)


def _actions(shape: bpy.types.Object) -> list[bpy.types.Action]:
    """Actions of an object and of its shape keys, also those in tracks."""
    keys = shape.data.shape_keys if shape.type == "MESH" else None
    found = []
    for owner in (shape, keys):
        if owner and owner.animation_data:
            data = owner.animation_data
            found += [strip.action for track in data.nla_tracks for strip in track.strips]
            found += [data.action] if data.action else []
    return found
