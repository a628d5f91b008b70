# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking through an imported camera sets the render resolution to its image's, and its photograph can be faded over the object."""

import bpy
import irgspp
import pytest
from irgspp.panels import cameras as cameras_panel
from irgspp.panels import result
from recording_layout import RecordingLayout, draw


@pytest.fixture
def extension():
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    yield
    irgspp.unregister()


def test_scene_takes_over_camera_and_size(extension, run_folder):
    bpy.ops.irgspp.import_run(directory=str(run_folder))
    bpy.context.scene.irgspp.dataset = str(run_folder)
    cameras = [thing for thing in bpy.context.scene.objects if thing.type == "CAMERA"]
    assert len({(camera.data["width"], camera.data["height"]) for camera in cameras}) > 1
    for camera in cameras:
        assert bpy.ops.irgspp.look_through(camera=camera.name) == {"FINISHED"}
        render = bpy.context.scene.render
        assert bpy.context.scene.camera == camera
        assert (render.resolution_x, render.resolution_y) == (camera.data["width"], camera.data["height"])
    assert not draw(cameras_panel.IRGSPP_PT_cameras).buttons("irgspp.look_through")  # the mesh is active
    bpy.context.view_layer.objects.active = cameras[0]
    assert draw(cameras_panel.IRGSPP_PT_cameras).buttons("irgspp.look_through")[0].values == {"camera": cameras[0].name}
    assert bpy.ops.irgspp.look_through() == {"FINISHED"} and bpy.context.scene.camera == cameras[0]


def test_other_objects_are_refused(extension):
    thing = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    bpy.context.scene.collection.objects.link(thing)
    for name in ("mine", "nobody", ""):
        with pytest.raises(RuntimeError, match="is not a camera of an imported"):
            bpy.ops.irgspp.look_through(camera=name)
    assert bpy.context.scene.camera is None


def test_the_photograph_fades_over_the_object(extension, run_folder):
    bpy.ops.irgspp.import_run(directory=str(run_folder))
    scene = bpy.context.scene
    scene.irgspp_photograph = 0.5  # without a camera there is no photograph
    assert scene.irgspp_photograph == 0
    scene.irgspp_comparison = "fade"
    assert bpy.ops.irgspp.step_photograph() == {"FINISHED"}
    shown = scene.camera.data.background_images[0]
    behind = shown.alpha
    assert scene.irgspp_photograph == 0 and shown.display_depth == "BACK" and behind > 0
    layout = RecordingLayout()
    result.draw_cameras(layout, bpy.context)
    assert "irgspp_photograph" in layout.properties
    scene.irgspp_photograph = 0.75
    assert (shown.display_depth, shown.alpha) == ("FRONT", 0.75)
    first = scene.camera
    bpy.ops.irgspp.step_photograph()
    after = scene.camera.data.background_images[0]
    assert scene.camera != first and (after.display_depth, after.alpha) == ("FRONT", 0.75)  # the next one fades as much
    scene.irgspp_photograph = 0
    assert (after.display_depth, after.alpha) == ("BACK", behind)


def test_a_camera_without_a_photograph_has_no_slider(extension, run_folder):
    bpy.ops.irgspp.import_run(directory=str(run_folder))
    bpy.ops.irgspp.step_photograph()
    bpy.context.scene.camera.data.background_images.clear()
    layout = RecordingLayout()
    result.draw_cameras(layout, bpy.context)
    assert "irgspp_photograph" not in layout.properties
    assert layout.buttons("irgspp.step_photograph")[1].text == bpy.context.scene.camera.name


def test_the_panel_compares_under_standard_and_restores(extension, run_folder):
    bpy.ops.irgspp.import_run(directory=str(run_folder))
    scene = bpy.context.scene
    bpy.ops.irgspp.step_photograph()

    def drawn():
        layout = RecordingLayout()
        result.draw_cameras(layout, bpy.context)
        return layout

    scene.view_settings.view_transform = "AgX"
    assert "irgspp_border" in drawn().properties and "irgspp_photograph" not in drawn().properties
    assert "AgX changes the colours of the result" in drawn().words
    assert drawn().buttons("irgspp.comparison_colours")[0].text == "Compare under Standard"
    assert bpy.ops.irgspp.comparison_colours() == {"FINISHED"} and scene.view_settings.view_transform == "Standard"
    (back,) = drawn().buttons("irgspp.comparison_colours")
    assert (back.text, back.values) == ("Restore AgX", {"restore": True})
    assert bpy.ops.irgspp.comparison_colours(restore=True) == {"FINISHED"} and scene.view_settings.view_transform == "AgX"
    scene.view_settings.view_transform = "Standard"
    assert not drawn().buttons("irgspp.comparison_colours")
