# SPDX-License-Identifier: GPL-3.0-or-later
"""Example of docs/architecture.md, "to add a panel": notes of an artist, kept with the scene."""

from types import SimpleNamespace

import blender_side  # noqa: F401  (before what imports bpy)
import bpy
import pytest
from irgspp.panels.sidebar import SidebarPanel, button
from recording_layout import RecordingLayout

# --- operators/notes.py and panels/notes.py


class IRGSPP_OT_clear_notes(bpy.types.Operator):
    """Empty the notes of this scene"""

    bl_idname, bl_label = "irgspp.clear_notes", "Clear Notes"

    def execute(self, context):
        context.scene["irgspp_notes"] = ""
        return {"FINISHED"}


class IRGSPP_PT_notes(SidebarPanel, bpy.types.Panel):
    """Words that stay with the scene"""

    bl_label, bl_order = "Notes", 90

    def draw(self, context):
        self.layout.label(text=context.scene.get("irgspp_notes") or "No notes yet")
        button(self.layout, "irgspp.clear_notes", "Clear", "TRASH")


CLASSES = (IRGSPP_OT_clear_notes, IRGSPP_PT_notes)  # into panels/registration.py and panels/__init__.py


@pytest.fixture(autouse=True)
def registered():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    yield
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)


def drawn():
    layout = RecordingLayout()
    IRGSPP_PT_notes.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.drawn


def test_the_panel_shows_the_notes_and_its_button_empties_them():
    bpy.context.scene["irgspp_notes"] = "front light"
    (label, button_drawn) = drawn()
    assert label[1] == "front light" and button_drawn[1] == "irgspp.clear_notes"
    assert bpy.ops.irgspp.clear_notes() == {"FINISHED"}
    assert drawn()[0][1] == "No notes yet"
