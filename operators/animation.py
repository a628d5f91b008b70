# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that render an animation of the light to numbered image files, and stop it."""

# pyright: reportInvalidTypeForm=false

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty

from ..irgspp_addon.importer.run_frame import chosen_run
from ..irgspp_addon.relight import animation
from ..irgspp_addon.relight.session import session_of
from ..irgspp_addon.translations import translated
from .blocking import SKIP, StartedByButton, refusing


class IRGSPP_OT_render_animation(StartedByButton, bpy.types.Operator):
    """Render the scene's frames, or one turn of the light, by IRGS++ to numbered files, while Blender stays usable."""

    bl_idname = "irgspp.render_animation"
    bl_label = "Render Animation"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    output: StringProperty(
        name="Output",
        description="Path of the files; their number and suffix are added. Empty: the scene's Output Path",
        subtype="FILE_PATH",
        options=SKIP,
    )
    turn: BoolProperty(
        name="Turn the Light",
        description="World and lamps turn once about the object while everything else stays; otherwise the scene's animation is rendered",
        default=False,
        options=SKIP,
    )
    frames: IntProperty(
        name="Frames", description="Frames of a turn of the light; 0: as many as the scene has", default=0, min=0, max=100_000, options=SKIP
    )

    @refusing()
    def start(self, context: bpy.types.Context) -> set[str]:
        """Start the animation without waiting for it."""
        animation.start(self._animation(context))
        return {"FINISHED"}

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Render the animation and return when it is finished."""
        animation.finish(self._animation(context))
        return {"FINISHED"}

    def _animation(self, context: bpy.types.Context) -> animation.LightAnimation:
        """Return the animation to render; raise IrgsppError where it can't be rendered."""
        scene = context.scene
        session_of(chosen_run(scene))  # raises at once where the engine or the run is missing
        frames = list(range(scene.frame_start, scene.frame_end + 1, max(1, scene.frame_step)))
        if self.turn and self.frames:
            frames = list(range(1, self.frames + 1))
        return animation.LightAnimation(scene, context.view_layer, frames, self.output or scene.render.filepath, self.turn)


class IRGSPP_OT_stop_animation(bpy.types.Operator):
    """Stop rendering the animation. Its finished frames stay."""

    bl_idname = "irgspp.stop_animation"
    bl_label = "Stop Animation"
    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True while an animation is rendered."""
        last = animation.animation()
        if last is None or last.ended:
            cls.poll_message_set(translated("No animation is rendered"))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Stop the animation."""
        animation.stop()
        return {"FINISHED"}


CLASSES = (IRGSPP_OT_render_animation, IRGSPP_OT_stop_animation)
