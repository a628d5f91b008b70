# SPDX-License-Identifier: GPL-3.0-or-later
"""Access to the extension's preferences: settings of this machine, not of a scene."""

import bpy

from ..user_folder import EXTENSION

# Blender as a module runs in a Python that may have the engine's libraries; Blender's own Python does not have them.
DEFAULT_KIND = "MANAGED" if bpy.app.binary_path else "INTERPRETER"
PAGE = "under Edit > Preferences > Add-ons > IRGS++"  # where an engine is chosen and installed, for messages


def preferences() -> bpy.types.AddonPreferences | None:
    """Return the extension's preferences, or None if it is used as a plain package."""
    addon = bpy.context.preferences.addons.get(EXTENSION)
    return addon.preferences if addon is not None else None
