# SPDX-License-Identifier: GPL-3.0-or-later
"""Animations of the light: numbered files of the engine's images, by the operator and by F12; a turn of the light; cancelling."""

import bpy
import numpy as np
import pytest
from blender_side import read_image
from irgspp.irgspp_addon.relight import animation
from irgspp.panels import relight
from mathutils import Vector
from recording_layout import RecordingLayout
from relighting import difference, mapping


@pytest.fixture
def animated(scene):
    """The scene with a World that turns by a right angle from frame 1 to 3, small images of few samples."""
    scene.irgspp.relight_samples, scene.render.resolution_percentage, scene.render.film_transparent = 16, 50, True
    scene.frame_start, scene.frame_end = 1, 3
    rotation = mapping(scene).inputs["Rotation"]
    for frame, angle in ((1, 0.0), (3, np.pi / 2)):
        rotation.default_value = (0, 0, angle)
        rotation.keyframe_insert("default_value", frame=frame)
    scene.frame_set(1)
    return scene


def test_the_operator_writes_what_f12_renders(animated, tmp_path):
    animated.render.engine = "IRGSPP"
    animated.render.filepath = str(tmp_path / "f12_")
    bpy.ops.render.render(animation=True)
    animated.frame_set(2)
    assert bpy.ops.irgspp.render_animation(output=str(tmp_path / "ours_")) == {"FINISHED"}
    assert animated.frame_current == 2 and animation.IMAGE not in bpy.data.images
    frames = [[read_image(tmp_path / f"{name}_{frame:04}.exr", 4) for frame in (1, 2, 3)] for name in ("f12", "ours")]
    for rendered, ours in zip(*frames, strict=True):
        assert difference(ours, rendered) < 1e-3
    assert difference(frames[0][0], frames[0][2]) > 0.05 and difference(frames[0][0], frames[0][1]) > 0.02


def test_a_turn_of_the_light_turns_world_and_lamps(animated, tmp_path):
    animated.animation_data_clear()
    mapping(animated).id_data.animation_data_clear()
    mapping(animated).inputs["Rotation"].default_value = (0, 0, 0)
    bpy.ops.object.light_add(type="POINT", location=(2, 0, 1.5))
    lamp = bpy.context.object
    lamp.data.energy = 300
    assert bpy.ops.irgspp.render_animation(output=str(tmp_path / "turn_##"), turn=True, frames=4) == {"FINISHED"}
    turned = [read_image(tmp_path / f"turn_{frame:02}.exr", 4) for frame in (1, 2, 3, 4)]
    assert min(difference(turned[0], other) for other in turned[1:]) > 0.05
    lamp.location = Vector((0, 2, 1.5))  # a quarter turn, counter-clockwise seen from above
    mapping(animated).inputs["Rotation"].default_value = (0, 0, -np.pi / 2)
    bpy.context.view_layer.update()
    animated.frame_start = animated.frame_end = 1
    bpy.ops.irgspp.render_animation(output=str(tmp_path / "still_"))
    assert difference(turned[1], read_image(tmp_path / "still_0001.exr", 4)) < 0.01


def test_png_goes_through_the_view_transform(animated, tmp_path):
    animated.frame_end = 1
    settings = animated.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "8"
    images = {}
    for transform in ("Standard", "AgX"):
        animated.view_settings.view_transform = transform
        bpy.ops.irgspp.render_animation(output=f"{tmp_path}/{transform}/")
        images[transform] = read_image(tmp_path / transform / "0001.png", 4)
    animated.render.engine, animated.render.filepath = "IRGSPP", str(tmp_path / "f12.png")
    bpy.ops.render.render(write_still=True)
    assert np.abs(images["AgX"] - read_image(tmp_path / "f12.png", 4)).max() < 0.02
    assert np.abs(images["AgX"] - images["Standard"]).max() > 0.05


def test_frames_that_exist_are_kept_where_the_scene_says_so(animated, tmp_path):
    animated.render.use_overwrite = False
    (tmp_path / "0002.exr").write_text("kept")
    bpy.ops.irgspp.render_animation(output=f"{tmp_path}/")
    assert (tmp_path / "0002.exr").read_text() == "kept" and (tmp_path / "0003.exr").is_file()


def test_stopping_keeps_finished_frames(animated, tmp_path):
    one = animation.LightAnimation(animated, bpy.context.view_layer, [1, 2, 3], f"{tmp_path}/", turn=False)
    animation.start(one)
    assert bpy.ops.irgspp.stop_animation.poll()
    while one.finished < 1 and not one.error:
        one.tick()
    layout = RecordingLayout()
    relight.draw_animation(layout, bpy.context)
    assert "Frame 2 of 3" in [entry[2] for entry in layout.drawn if entry[0] == "progress"] and 0.3 < one.fraction < 0.7
    assert bpy.ops.irgspp.stop_animation() == {"FINISHED"}
    assert one.ended and not one.error and not bpy.ops.irgspp.stop_animation.poll()
    assert [file.name for file in tmp_path.glob("0*.exr")] == ["0001.exr"]
    assert animated.frame_current == 1
    layout = RecordingLayout()
    relight.draw_animation(layout, bpy.context)
    (offer,) = layout.buttons("wm.path_open")
    assert offer.values == {"filepath": str(tmp_path)}


def test_opening_another_file_ends_it(animated, tmp_path):
    one = animation.LightAnimation(animated, bpy.context.view_layer, [1, 2, 3], f"{tmp_path}/", turn=False)
    animation.start(one)
    one.tick()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert one.ended and not one.error and animation.animation() is None


def test_errors_are_one_line(animated, tmp_path):
    words = {"output": f"{tmp_path}/"}
    if bpy.app.version >= (5, 0, 0):
        animated.render.image_settings.media_type = "VIDEO"
    animated.render.image_settings.file_format = "FFMPEG"
    with pytest.raises(RuntimeError, match="a video"):
        bpy.ops.irgspp.render_animation(**words)
    if bpy.app.version >= (5, 0, 0):
        animated.render.image_settings.media_type = "IMAGE"
    animated.render.image_settings.file_format = "OPEN_EXR"
    animated.camera = None
    with pytest.raises(RuntimeError, match="has no camera"):
        bpy.ops.irgspp.render_animation(**words)
    animated.render.filepath = ""
    with pytest.raises(RuntimeError, match="no folder is named"):
        bpy.ops.irgspp.render_animation()
