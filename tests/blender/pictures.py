"""Pictures of a scene, rendered in Blender."""

from pathlib import Path

import bpy

PICTURE = 96
"""Edge [pixels]."""


def picture(frame, eye):
    """Render a frame for an eye that looks down, as a file in the working folder; its name."""
    file = Path(f"picture{frame}.png")
    scene = bpy.context.scene
    scene.frame_set(frame)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.render.resolution_x = scene.render.resolution_y = PICTURE
    scene.render.film_transparent = True
    if scene.camera is None:
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        scene.collection.objects.link(camera)
        scene.camera = camera
    scene.camera.location = eye
    scene.render.filepath = str(file.resolve())
    bpy.ops.render.render(write_still=True)
    return file.name
