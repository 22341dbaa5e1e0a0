"""The panel in the sidebar of the 3D viewport."""

from __future__ import annotations

import bpy

from . import operators


class MORPH_PT_panel(bpy.types.Panel):
    """Source, target, material, time, and how far it is."""

    bl_label = "Morph"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Morph"

    def draw(self, context: bpy.types.Context) -> None:
        """All of it, from the shapes down to the button."""
        settings = context.scene.chamfer_morph
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("source", "target", "preset", "detail", "frames", "seconds", "snap", "hide"):
            layout.prop(settings, name)
        morph = operators.running
        if morph is None:
            layout.operator("chamfer_morph.morph", icon="MOD_FLUIDSIM")
            return
        row = layout.row()
        row.progress(factor=morph.progress, text=morph.stage)
        row.operator("chamfer_morph.stop", text="", icon="CANCEL")
