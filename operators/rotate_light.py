# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that rotates the World by dragging in the 3D View."""

# pyright: reportInvalidTypeForm=false

from math import degrees, radians
from typing import Any

import bpy
from bpy.props import FloatProperty

from ..irgspp_addon.translations import translated
from ..irgspp_addon.world.light_controls import UP, light_controls
from .blocking import SKIP

PER_PIXEL = radians(0.5)  # rotation per pixel of the mouse's way
PRECISE = 0.1  # factor of it while Shift is held
CONFIRM = ("LEFTMOUSE", "RET", "NUMPAD_ENTER", "SPACE")
CANCEL = ("ESC", "RIGHTMOUSE")


class IRGSPP_OT_rotate_light(bpy.types.Operator):
    """Rotate the World about the vertical axis: move the mouse left and right, click to confirm, Esc to restore, Shift for precision."""

    bl_idname = "irgspp.rotate_light"
    bl_label = "Rotate Light"
    bl_options = {"REGISTER", "UNDO", "GRAB_CURSOR", "BLOCKING"}  # noqa: RUF012 (Blender wants a plain set)

    angle: FloatProperty(name="Angle", description="Rotation to add", subtype="ANGLE", default=0.0, options=SKIP)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where the World has a rotation that can be set."""
        if light_controls(context.scene.world).rotation is None:
            cls.poll_message_set(translated("The World has no Mapping node to rotate; open an HDRI"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Begin to drag.

        Args:
            context: of the button or menu.
            event: with the mouse's place.
        """
        self._start, self._x, self.angle = self._rotation(context), event.mouse_x, 0.0
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Follow the mouse until a click or Esc.

        Args:
            context: of the window.
            event: of mouse or keyboard.
        """
        if light_controls(context.scene.world).rotation is None:  # the World was changed meanwhile
            return self._end(context, {"CANCELLED"})
        if event.type == "MOUSEMOVE":
            self.angle += (event.mouse_x - self._x) * PER_PIXEL * (PRECISE if event.shift else 1.0)
            self._x = event.mouse_x
            self._rotate(context, self._start + self.angle)
        elif event.type in CANCEL:
            self._rotate(context, self._start)
            return self._end(context, {"CANCELLED"})
        elif event.type in CONFIRM and event.value == "PRESS":
            return self._end(context, {"FINISHED"})
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Rotate by the angle."""
        self._rotate(context, self._rotation(context) + self.angle)
        return {"FINISHED"}

    def _rotation(self, context: bpy.types.Context) -> float:
        """Return the present rotation in radians."""
        return _socket(context).default_value[UP]

    def _rotate(self, context: bpy.types.Context, angle: float) -> None:
        """Set the rotation and tell it in the area's header."""
        _socket(context).default_value[UP] = angle
        if context.area is not None:
            text = translated("Rotation {angle}°   click: confirm, Esc: restore, Shift: precise", angle=f"{degrees(angle):.1f}")
            context.area.header_text_set(text)

    def _end(self, context: bpy.types.Context, result: set[str]) -> set[str]:
        """Give the header back and return the result."""
        if context.area is not None:
            context.area.header_text_set(None)
        return result


def _socket(context: bpy.types.Context) -> Any:
    """Return the rotation of the World's Mapping node, which `poll` has found."""
    return light_controls(context.scene.world).rotation


CLASSES = (IRGSPP_OT_rotate_light,)
