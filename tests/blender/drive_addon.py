"""What an artist does with the add-on: install it, choose two objects, press the button.

Run in Blender by `test_addon.py` with the zip and the address of a service; prints JSON.
"""

import json
import sys
import time
from types import SimpleNamespace

import bpy
from pictures import picture

ABOVE = (10, 20, 45)


def main(extension, address):
    """Morph a ball into a cone, and try it without a service."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=extension, repo="user_default")
    (name,) = (each for each in bpy.context.preferences.addons.keys() if "chamfer_morph" in each)
    preferences = bpy.context.preferences.addons[name].preferences
    ball, cone = a_ball_and_a_cone()
    settings = bpy.context.scene.chamfer_morph
    found = {"without target": bpy.ops.chamfer_morph.morph.poll()}
    settings.source, settings.target = ball, cone
    settings.frames, settings.detail, settings.seconds = 8, 2, 0.5
    preferences.address = "http://127.0.0.1:9"
    try:
        bpy.ops.chamfer_morph.morph()
    except RuntimeError as error:
        found["without service"] = str(error)
    preferences.address = address
    found["outcome"] = list(bpy.ops.chamfer_morph.morph())
    (result,) = (each for each in bpy.data.objects if each.name == "Ball to Cone")
    for original in (ball, cone):
        original.hide_render = True
    scene = bpy.context.scene
    ends = scene.frame_start, scene.frame_end
    found |= {
        "frames": ends,
        "hidden": [ball.hide_get(), cone.hide_get()],
        "cone": bounds(cone),
        "shapes": [bounds(result, frame) for frame in range(ends[0], ends[1] + 1)],
        "vertices": len(result.data.vertices),
        "pictures": [picture(frame, ABOVE) for frame in ends],
    }
    found |= pressed(name)
    sys.stdout.write(f"FOUND {json.dumps(found)}\n")


def pressed(addon):
    """What the button does: a morph that goes on while the window stays usable, twice.

    Without a window Blender neither presses buttons nor lets timers tick: an operator like it does
    the first, and events are told to it by hand.
    """
    operators = sys.modules[f"{addon}.operators"]
    held = []

    class Button(operators.MORPH_OT_morph):
        bl_idname = "chamfer_morph.button"

        def execute(self, context):
            held.append(self)
            return self.invoke(context, SimpleNamespace(type="LEFTMOUSE"))

    bpy.utils.register_class(Button)
    found = {
        "pressed": list(bpy.ops.chamfer_morph.button()),
        "again meanwhile": operators.MORPH_OT_morph.poll(bpy.context),
        "mouse": list(told(held[-1], "MOUSEMOVE")),
    }
    settings = bpy.context.scene.chamfer_morph
    source, settings.source = settings.source, None  # as when it is deleted
    settings.hide = False
    source.hide_set(False)
    found["chosen meanwhile"] = ticked_to_the_end(held[-1])[-1], source.hide_get()
    settings.source = source
    bpy.ops.chamfer_morph.button()
    found["stopped"] = [list(bpy.ops.chamfer_morph.stop()), ticked_to_the_end(held[-1])]
    found["stop again"] = bpy.ops.chamfer_morph.stop.poll()
    return found


def told(operator, event):
    """What an operator that goes on answers to an event."""
    return operator.modal(bpy.context, SimpleNamespace(type=event))


def ticked_to_the_end(operator):
    """Answers of an operator to a timer, each once, until it has ended."""
    answers = []
    while not answers or "PASS_THROUGH" in answers[-1]:
        answer = sorted(told(operator, "TIMER"))
        answers += [answer] if answer not in answers else []
        time.sleep(0.1)
    return answers


def a_ball_and_a_cone():
    """Two objects far from the origin, one of them with a modifier and turned."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1.2, location=(10, 20, 30))
    ball = bpy.context.object
    ball.name = "Ball"
    bpy.ops.mesh.primitive_cone_add(radius1=1.5, depth=4, location=(10, 20, 30), rotation=(0, 1, 0))
    cone = bpy.context.object
    cone.name = "Cone"
    cone.modifiers.new("rounded", "BEVEL").width = 0.2
    return ball, cone


def bounds(shape, frame=None):
    """Lowest and highest coordinates in the scene, at a frame."""
    if frame is not None:
        bpy.context.scene.frame_set(frame)
    seen = shape.evaluated_get(bpy.context.evaluated_depsgraph_get())
    vertices = [seen.matrix_world @ vertex.co for vertex in seen.to_mesh().vertices]
    return [[end(v[axis] for v in vertices) for axis in range(3)] for end in (min, max)]


main(*sys.argv[-2:])
