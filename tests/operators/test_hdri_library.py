# SPDX-License-Identifier: GPL-3.0-or-later
"""HDRIs are chosen from Blender's own and those of a folder, and rotated by dragging."""

from math import pi
from types import SimpleNamespace

import bpy
import pytest
from blender_side import write_image
from irgspp.irgspp_addon.world import hdri_library
from irgspp.irgspp_addon.world.light_controls import UP, light_controls
from irgspp.operators.rotate_light import PER_PIXEL, IRGSPP_OT_rotate_light
from irgspp.panels import relight
from recording_layout import RecordingLayout
from relighting import lamp


@pytest.fixture
def scene(default_scene):
    return default_scene


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The user's folder with two HDRIs, a text and a damaged image."""
    for name in ("b.exr", "A.exr"):
        write_image(tmp_path / name, lamp())
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "broken.hdr").write_text("x")
    monkeypatch.setattr(hdri_library, "preferences", lambda: SimpleNamespace(hdri_folder=str(tmp_path)))
    read_again(monkeypatch)
    return tmp_path


def read_again(monkeypatch) -> None:
    """Let the library be listed anew at the next look, whenever the last one was."""
    monkeypatch.setattr(hdri_library, "_read", -hdri_library.CHECK_SECONDS)


def test_the_user_s_files_come_before_blender_s(scene, folder):
    names = [file.name for file in hdri_library.library()]
    assert names[:3] == ["A.exr", "b.exr", "broken.hdr"] and "studio.exr" in names[3:]
    items = hdri_library.hdri_items(scene, bpy.context)
    assert [item[1] for item in items[:3]] == ["Choose", "A", "b"] and len({item[4] for item in items}) == len(items)
    assert hdri_library.hdri_items(scene, None)[1] is items[1]  # Blender keeps no reference to its strings


def test_choices_keep_their_numbers_when_files_come(scene, folder, monkeypatch):
    before = {item[0]: item[4] for item in hdri_library.hdri_items(scene, None)}
    write_image(folder / "0.exr", lamp())
    read_again(monkeypatch)
    after = {item[0]: item[4] for item in hdri_library.hdri_items(scene, None)}
    assert after.pop(str(folder / "0.exr")) not in before.values() and after == before


def test_a_missing_folder_leaves_blender_s_files_and_is_told(scene, monkeypatch, tmp_path):
    monkeypatch.setattr(hdri_library, "preferences", lambda: SimpleNamespace(hdri_folder=str(tmp_path / "gone")))
    assert {file.suffix for file in hdri_library.library()} == {".exr"}
    layout = RecordingLayout()
    relight.draw_light(layout, bpy.context)
    assert "is not there; choose it again" in layout.words
    monkeypatch.setattr(hdri_library, "preferences", lambda: None)
    assert len(hdri_library.library()) >= 5 and hdri_library.unreadable_folder() is None


def test_choosing_lights_the_scene_and_keeps_the_rotation(scene, folder, capfd):
    scene.irgspp.use_world = False
    assert scene.irgspp_hdri == "OTHER"
    scene.irgspp_hdri = str(folder / "b.exr")
    assert scene.world.name == "b" and scene.irgspp.use_world
    assert bpy.ops.irgspp.rotate_light(angle=0.5) == {"FINISHED"}
    scene.irgspp_hdri = next(item[0] for item in hdri_library.hdri_items(scene, None) if item[1] == "studio")
    assert scene.world.name == "studio" and light_controls(scene.world).rotation.default_value[UP] == pytest.approx(0.5)
    scene.irgspp_hdri = str(folder / "broken.hdr")
    assert scene.world.name == "studio" and "can't be read" in capfd.readouterr().err


def test_the_thumbnail_is_what_the_world_shows(scene, folder, tmp_path_factory):
    elsewhere = write_image(tmp_path_factory.mktemp("elsewhere") / "own.exr", lamp())
    bpy.ops.irgspp.open_hdri(filepath=str(elsewhere))
    assert scene.irgspp_hdri == str(elsewhere) and hdri_library.hdri_items(scene, None)[0][1] == "own"
    world = scene.world
    scene.irgspp_hdri = str(elsewhere)
    assert scene.world == world  # it is shown already
    scene.irgspp_hdri = str(folder / "A.exr")
    names = [item[1] for item in hdri_library.hdri_items(scene, None)]
    assert names[0] == "A" and "own" not in names and "Choose" not in names
    scene.world = None
    assert scene.irgspp_hdri == "OTHER"


def test_dragging_rotates_and_escape_restores(scene, folder):
    scene.irgspp_hdri = str(folder / "A.exr")
    rotation, said, stays = light_controls(scene.world).rotation, [], {"RUNNING_MODAL"}
    rotation.default_value[UP] = 1.0
    manager = SimpleNamespace(modal_handler_add=lambda operator: None)
    context = SimpleNamespace(scene=scene, window_manager=manager, area=SimpleNamespace(header_text_set=said.append))
    own = ("_rotation", "_rotate", "_end", "invoke", "modal")
    tool = type("Tool", (), {name: getattr(IRGSPP_OT_rotate_light, name) for name in own})()

    def event(kind, x=0, shift=False, value="PRESS"):
        return SimpleNamespace(type=kind, mouse_x=x, shift=shift, value=value)

    assert tool.invoke(context, event("LEFTMOUSE", 100)) == stays
    assert tool.modal(context, event("MOUSEMOVE", 140)) == stays
    assert rotation.default_value[UP] == pytest.approx(1 + 40 * PER_PIXEL)
    tool.modal(context, event("MOUSEMOVE", 150, shift=True))
    assert rotation.default_value[UP] == pytest.approx(1 + 41 * PER_PIXEL) and "Esc" in said[-1]
    assert tool.modal(context, event("LEFTMOUSE", value="RELEASE")) == stays  # of the click on the button
    assert tool.modal(context, event("ESC")) == {"CANCELLED"} and said[-1] is None
    assert rotation.default_value[UP] == pytest.approx(1.0)
    tool.invoke(context, event("LEFTMOUSE", 0))
    tool.modal(context, event("MOUSEMOVE", -20))
    assert tool.modal(context, event("LEFTMOUSE")) == {"FINISHED"}
    assert rotation.default_value[UP] == pytest.approx(1 - 20 * PER_PIXEL)
    tool.invoke(context, event("LEFTMOUSE", 0))
    scene.world = None
    assert tool.modal(context, event("MOUSEMOVE", 5)) == {"CANCELLED"}


def test_worlds_without_rotation_are_refused(scene):
    assert not bpy.ops.irgspp.rotate_light.poll()
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.irgspp.rotate_light(angle=pi)


def test_the_panel_shows_the_library(scene, folder):
    layout = RecordingLayout()
    relight.draw_light(layout, bpy.context)
    assert ("icon_view", "irgspp_hdri") in layout.drawn and not layout.buttons("irgspp.rotate_light")
    scene.irgspp_hdri = str(folder / "A.exr")
    layout = RecordingLayout()
    relight.draw_light(layout, bpy.context)
    assert layout.buttons("irgspp.rotate_light")
