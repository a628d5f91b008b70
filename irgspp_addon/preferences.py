# SPDX-License-Identifier: GPL-3.0-or-later
"""What belongs to this machine rather than to a scene."""

# pyright: reportInvalidTypeForm=false

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from .user_folder import EXTENSION

# Blender as a module runs in a Python that may well have the libraries; Blender's own Python has not.
DEFAULT_KIND = "MANAGED" if bpy.app.binary_path else "INTERPRETER"
KINDS = [
    ("EXISTING", "Existing", "A Python environment that has the engine's libraries", 0),
    ("MANAGED", "Managed", "An environment that this extension installs for itself", 1),
    ("INTERPRETER", "Blender's Python", "The Python that Blender itself runs, where the libraries are installed for it", 2),
]
DEVICES = [
    ("cpu", "CPU", "What the processor needs", 0),
    ("cuda", "CUDA", "What an NVIDIA graphics card needs as well; larger by some gigabytes", 1),
]


def _choose_existing(chosen: "IRGSPP_Preferences", context: bpy.types.Context) -> None:
    if chosen.engine_python:
        chosen.engine_kind = "EXISTING"


class IRGSPP_Preferences(bpy.types.AddonPreferences):
    """Where the engine runs."""

    bl_idname = EXTENSION

    engine_kind: EnumProperty(
        name="Engine",
        description="What computes: a Python of its own, as its libraries must not enter Blender",
        items=KINDS,
        default=DEFAULT_KIND,
    )
    engine_python: StringProperty(
        name="Engine Python",
        description="Python executable, or folder of a virtual environment, with the engine's libraries (torch and others)",
        subtype="FILE_PATH",
        update=_choose_existing,
    )
    install_device: EnumProperty(name="For", description="What the engine shall compute on", items=DEVICES)
    wheels_folder: StringProperty(
        name="Wheels",
        description="Folder of Python wheels to install from without the network. Empty: download them",
        subtype="DIR_PATH",
    )
    package_index: StringProperty(
        name="Package Index",
        description="Address of another index that pip looks in as well, such as that of torch for the CPU alone. Empty: pip's own",
    )
    keep_running: BoolProperty(
        name="Jobs Survive Blender",
        description="Let jobs go on when Blender is closed; otherwise they save what they have and stop, and can be resumed",
        default=False,
    )

    def draw(self, context: bpy.types.Context) -> None:
        from .preferences_page import draw_preferences  # it asks the engine, which asks the preferences

        draw_preferences(self, self.layout)


def preferences() -> IRGSPP_Preferences | None:
    """The extension's preferences; None where it is used as a plain package."""
    addon = bpy.context.preferences.addons.get(EXTENSION)
    return addon.preferences if addon is not None else None  # type: ignore[return-value]
