"""What can be chosen: for each scene, and in the preferences.

Blender reads annotations as they are: they must not be postponed here.
"""

import bpy

from .scene import KINDS

MATERIALS = (
    ("fast", "Elastic", "Firm matter that keeps its parts together"),
    ("stiff", "Stiff", "Bends rather than flows; remembers its shape longest"),
    ("soft", "Soft", "Swings, and is rounded on the way"),
    ("viscous", "Viscous", "Flows slowly and forgets its shape"),
    ("fluid", "Fluid", "Flows freely, and draws together into drops"),
)


def _has_surface(settings: bpy.types.PropertyGroup, shape: bpy.types.Object) -> bool:
    return shape.type in KINDS


class MorphSettings(bpy.types.PropertyGroup):
    """Of a scene."""

    source: bpy.props.PointerProperty(
        type=bpy.types.Object, poll=_has_surface, name="Source", description="Object to begin with"
    )
    target: bpy.props.PointerProperty(
        type=bpy.types.Object, poll=_has_surface, name="Target", description="Object to end as"
    )
    preset: bpy.props.EnumProperty(
        items=MATERIALS, name="Material", description="What the matter is like on the way"
    )
    detail: bpy.props.IntProperty(
        name="Detail", default=3, min=1, max=6, soft_min=2, soft_max=5,
        description="Particles per cell edge: 3 makes some 40 000 of them, 6 eight times as many",
    )  # fmt: skip
    frames: bpy.props.IntProperty(
        name="Steps", default=40, min=2, max=1000, description="Shapes that are simulated between"
    )
    seconds: bpy.props.FloatProperty(
        name="Duration", default=2.0, min=0.1, max=600, unit="TIME_ABSOLUTE", subtype="TIME",
        description="How long the morph plays",
    )  # fmt: skip
    snap: bpy.props.BoolProperty(
        name="Keep Details", default=True,
        description="Give the first and last shapes the details of your own meshes",
    )  # fmt: skip
    hide: bpy.props.BoolProperty(
        name="Hide Originals", default=True, description="Hide source and target afterwards"
    )


class MorphPreferences(bpy.types.AddonPreferences):
    """Where the service is."""

    bl_idname = __package__

    address: bpy.props.StringProperty(
        name="Service", default="http://127.0.0.1:8000",
        description="Address of the morph service, which `morph serve` starts on this machine",
    )  # fmt: skip
    key: bpy.props.StringProperty(
        name="API Key", subtype="PASSWORD", description="Not needed on your own machine"
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Both in the preferences."""
        self.layout.prop(self, "address")
        self.layout.prop(self, "key")
