"""What Blender does with a surface, as a script: import, colours, light, camera, a picture.

    morph export sphere-to-bunny.vtkhdf -o bunny.glb --surface --fields displacement
    blender --background --python examples/blender_picture.py -- bunny.glb bunny.png

Needs Blender 4.2 or newer, or its Python module (pip install bpy) and `python` in place of
`blender --background --python` and `--`. Shapes that stand on z: --turn 90.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import bpy
from mathutils import Vector


def main() -> None:
    """Read the command line, set the scene and render it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("surface", type=Path, help="a .glb file")
    parser.add_argument("picture", type=Path, help="the .png file to write")
    parser.add_argument("--turn", type=float, default=0.0, help="about x, in degrees")
    parser.add_argument("--samples", type=int, default=64)
    own = sys.argv.index("--") + 1 if "--" in sys.argv else 1  # Blender's come before
    arguments = parser.parse_args(sys.argv[own:])

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(arguments.surface.resolve()))
    (shape,) = (each for each in bpy.context.scene.objects if each.type == "MESH")
    shape.rotation_mode = "XYZ"
    shape.rotation_euler.x += math.radians(arguments.turn)
    bpy.context.view_layer.update()
    colored(shape)
    corners = [shape.matrix_world @ Vector(corner) for corner in shape.bound_box]
    low, high = (Vector(map(pick, zip(*corners, strict=True))) for pick in (min, max))
    light()
    floor(low, (high - low).length)
    look_at((low + high) / 2, (high - low).length)

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = arguments.samples
    scene.render.resolution_x, scene.render.resolution_y = 960, 720
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(arguments.picture.resolve())
    bpy.ops.render.render(write_still=True)
    assert arguments.picture.stat().st_size > 0, "The picture should be written."


def colored(shape: bpy.types.Object) -> None:
    """Colours as the file has them, on clay; clay alone where it has none."""
    material = bpy.data.materials.new("matter")
    material.use_nodes = True
    surface = material.node_tree.nodes["Principled BSDF"]
    surface.inputs["Roughness"].default_value = 0.55
    if shape.data.color_attributes:
        colors = material.node_tree.nodes.new("ShaderNodeVertexColor")
        colors.layer_name = shape.data.color_attributes[0].name
        material.node_tree.links.new(colors.outputs["Color"], surface.inputs["Base Color"])
    shape.data.materials.clear()
    shape.data.materials.append(material)
    for polygon in shape.data.polygons:
        polygon.use_smooth = True


def light() -> None:
    """A sun from the left, and a bright sky."""
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 2.0, 0.15
    sun.rotation_euler = (math.radians(50), 0, math.radians(-35))
    bpy.context.collection.objects.link(sun)
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.4
    bpy.context.scene.world = world


def floor(low: Vector, size: float) -> None:
    """A white floor below the shape."""
    bpy.ops.mesh.primitive_plane_add(size=20 * size, location=(0, 0, low.z))


def look_at(centre: Vector, size: float) -> None:
    """A camera in front, a little above, that sees all of the shape."""
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = centre + Vector((0.55, -1.25, 0.55)).normalized() * 1.35 * size
    camera.rotation_euler = (centre - camera.location).to_track_quat("-Z", "Y").to_euler()
    bpy.context.collection.objects.link(camera)
    bpy.context.scene.camera = camera


if __name__ == "__main__":
    main()
