"""The operators: morph two objects, and stop."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy

from . import scene
from .morph import Morph, Request
from .service import Service

LOOK_SECONDS = 0.2
"""How often the window follows the morph [s]."""

running: Morph | None = None
"""The morph that goes on."""


class MORPH_OT_morph(bpy.types.Operator):
    """Send both objects, wait, and bring the animation into the scene."""

    bl_idname = "chamfer_morph.morph"
    bl_label = "Morph"
    bl_description = "Let the source become the target"
    bl_options = frozenset({"REGISTER", "UNDO"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with two objects that can be seen, one morph at a time, outside of edit mode."""
        settings = context.scene.chamfer_morph
        if running is not None:
            cls.poll_message_set("A morph is on its way")
        elif not (settings.source and settings.target):
            cls.poll_message_set("Choose a source and a target")
        elif settings.source == settings.target:
            cls.poll_message_set("Source and target are the same object")
        elif not {settings.source, settings.target} <= set(context.view_layer.objects):
            cls.poll_message_set("Source and target have to be in the view layer")
        elif context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first")
        else:
            return True
        return False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Morph while the window stays usable."""
        self._begin(context)
        window = context.window_manager
        self._timer = window.event_timer_add(LOOK_SECONDS, window=context.window)
        window.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Morph and wait, as scripts do."""
        self._begin(context).wait()
        return self._end(context)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Look how far it is."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        for area in context.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
        if running is not None and running.is_running:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self._end(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender closes, or loads another file."""
        global running
        if running is not None:
            running.cancel()
            running = None

    def _begin(self, context: bpy.types.Context) -> Morph:
        global running
        settings, preferences = context.scene.chamfer_morph, _preferences(context)
        self._folder = tempfile.TemporaryDirectory(prefix="chamfer_morph_")
        folder = Path(self._folder.name)
        source, target = settings.source, settings.target
        # what the window changes while the morph is on its way is of the next one
        self._name = f"{source.name} to {target.name}"
        self._hidden = [source.name, target.name] if settings.hide else []
        request = Request(
            source=folder / "source" / f"{bpy.path.clean_name(source.name)}.glb",
            target=folder / "target" / f"{bpy.path.clean_name(target.name)}.glb",
            result=folder / "result" / "morph.glb",
            preset=settings.preset,
            detail=settings.detail,
            frames=settings.frames,
            seconds=settings.seconds,
            fps=context.scene.render.fps / context.scene.render.fps_base,
            snap=settings.snap,
        )
        for path in (request.source, request.target, request.result):
            path.parent.mkdir()
        scene.write_mesh(source, request.source)
        scene.write_mesh(target, request.target)
        self._request = request
        running = Morph(Service(preferences.address, preferences.key), request)
        running.start()
        return running

    def _end(self, context: bpy.types.Context) -> set[str]:
        global running
        morph, running = running, None
        with self._folder:
            if morph is None or morph.is_cancelled:
                self.report({"INFO"}, "The morph was stopped")
                return {"CANCELLED"}
            if morph.error:
                self.report({"ERROR"}, morph.error)
                return {"CANCELLED"}
            scene.let_play(scene.read_animation(self._request.result, self._name))
            for name in self._hidden:
                if original := context.view_layer.objects.get(name):
                    original.hide_set(True)
        self.report({"INFO"}, f"{self._name} is in the scene")
        return {"FINISHED"}


class MORPH_OT_stop(bpy.types.Operator):
    """End the morph, and its job."""

    bl_idname = "chamfer_morph.stop"
    bl_label = "Stop"
    bl_description = "Stop the morph that is on its way"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while there is one."""
        return running is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask it to end."""
        if running is not None:
            running.cancel()
        return {"FINISHED"}


def _preferences(context: bpy.types.Context) -> bpy.types.AddonPreferences:
    return context.preferences.addons[__package__].preferences
