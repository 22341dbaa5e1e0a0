"""What an artist does with a point cache: import the mesh, give it the cache, play.

Run in Blender by `test_point_cache.py` with mesh, cache and frames; prints JSON.
"""

import json
import sys

import bpy


def main(mesh, cache, frames):
    """Where the vertices are in some frames, in the object's own coordinates."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.obj_import(filepath=mesh)
    (shape,) = bpy.context.selected_objects
    modifier = shape.modifiers.new("morph", "MESH_CACHE")
    modifier.cache_format = "PC2"
    modifier.filepath = cache
    found = {}
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown = shape.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        found[frame] = [list(vertex.co) for vertex in shown.vertices]
    sys.stdout.write(f"FOUND {json.dumps(found)}\n")


main(sys.argv[1], sys.argv[2], [int(each) for each in sys.argv[3:]])
