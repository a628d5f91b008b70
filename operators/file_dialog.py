# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that ask for a file by Blender's file browser."""

from __future__ import annotations

import bpy


class FileDialog:
    """Mix-in of an operator with the property `filepath`: its button opens the file browser, and Blender then calls `execute`."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}
