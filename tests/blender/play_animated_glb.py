"""What an artist does with an animated GLB: import it, play it, render it.

Run in Blender by `test_animated_glb.py` with the file, its frames per second and how many they are;
prints JSON, and leaves pictures in the working folder.
"""

import json
import sys

import bpy
from pictures import picture

HIDDEN = 1e-12
"""Volume that a mesh is scaled to where it is not shown."""


def main(path, fps, count):
    """Which meshes are shown in each frame, and where; pictures of three of them."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = fps
    bpy.ops.import_scene.gltf(filepath=path)
    meshes = [each for each in bpy.context.scene.objects if each.type == "MESH"]
    frames = [shown(meshes, frame) for frame in range(count)]
    eye = above([corner for frame in frames for mesh in frame for corner in mesh["corners"]])
    found = {
        "meshes": [mesh.name for mesh in meshes],
        "keys": [len(mesh.data.shape_keys.key_blocks) for mesh in meshes],
        "frames": frames,
        "pictures": [picture(frame, eye) for frame in (0, count // 2, count - 1)],
    }
    sys.stdout.write(f"FOUND {json.dumps(found)}\n")


def shown(meshes, frame):
    """The meshes that can be seen in a frame, as they are in the scene."""
    bpy.context.scene.frame_set(frame)
    now = [mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()) for mesh in meshes]
    return [
        {
            "name": mesh.name,
            "corners": [list(mesh.matrix_world @ vertex.co) for vertex in mesh.data.vertices],
            "triangles": len(mesh.data.polygons),
        }
        for mesh in now
        if abs(mesh.matrix_world.determinant()) > HIDDEN
    ]


def above(corners):
    """A place from which all corners are in the picture of a camera that looks down."""
    low, high = ([end(axis) for axis in zip(*corners, strict=True)] for end in (min, max))
    x, y, _ = ((one + other) / 2 for one, other in zip(low, high, strict=True))
    return x, y, high[2] + 2 * max(high[0] - low[0], high[1] - low[1])


main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
