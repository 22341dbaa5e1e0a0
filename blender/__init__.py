"""Blender extension: one object becomes another, computed by the morph service."""

from __future__ import annotations

import bpy

from .operators import MORPH_OT_morph, MORPH_OT_stop
from .panel import MORPH_PT_panel
from .settings import MorphPreferences, MorphSettings

CLASSES = (MorphSettings, MorphPreferences, MORPH_OT_morph, MORPH_OT_stop, MORPH_PT_panel)


def register() -> None:
    """Blender turns the extension on."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.chamfer_morph = bpy.props.PointerProperty(type=MorphSettings)


def unregister() -> None:
    """Blender turns it off."""
    del bpy.types.Scene.chamfer_morph
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
