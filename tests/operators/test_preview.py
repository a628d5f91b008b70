# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview: it follows the scene, reports errors, and outlives its worker."""

import time
from math import pi
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from blender_side import read_image
from irgspp.irgspp_addon.importer.run_frame import run_object
from irgspp.irgspp_addon.relight import live_image as relight_follow
from irgspp.irgspp_addon.relight import preview
from irgspp.irgspp_addon.relight import session as relight_session
from mathutils import Euler
from relighting import difference, image_pixels, mapping


def follow_until(what, seconds=300.0):
    end = time.monotonic() + seconds
    while not what():
        relight_follow.beat()
        time.sleep(0.05)
        assert time.monotonic() < end, preview.preview_message()


def started(scene, run, **how):
    return preview.start_preview(scene, run, {"samples": 16, "use_world": True, **how}, 64, "camera")


def test_the_preview_is_shown_through_the_scene_s_view_transform(scene, relightable, tmp_path):
    """The Image Editor shows it like a render: saved through AgX, Filmic or Standard it is the file of F12."""
    scene.irgspp.relight_samples, scene.render.film_transparent, scene.render.engine = 16, True, "IRGSPP"
    follower = started(scene, relightable)
    follow_until(lambda: follower.done)
    image = bpy.data.images[preview.IMAGE]
    assert image.use_view_as_render and image.is_float and image.alpha_mode == "PREMUL"
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "8"
    shown = {}
    for transform in ("AgX", "Filmic", "Standard"):
        scene.view_settings.view_transform = transform
        image.save_render(str(tmp_path / f"{transform}.png"), scene=scene)
        scene.render.filepath = str(tmp_path / "f12.png")
        bpy.ops.render.render(write_still=True)
        shown[transform] = read_image(tmp_path / f"{transform}.png", 4)
        assert np.abs(shown[transform] - read_image(tmp_path / "f12.png", 4)).max() < 0.02
    assert np.abs(shown["AgX"] - shown["Standard"]).max() > 0.05
    image.use_view_as_render = False  # as in a file of another add-on
    assert preview.preview_image(*image.size) == image and image.use_view_as_render


def test_the_preview_follows_world_camera_object_and_albedo(scene, relightable):
    follower = started(scene, relightable)
    follow_until(lambda: follower.done)
    seen = [image_pixels()]

    def changed() -> None:
        bpy.context.view_layer.update()
        before = follower._requested
        relight_follow.beat()  # a quick worker may answer within it, so that `done` can be true again
        assert follower._requested != before
        follow_until(lambda: follower.done)
        seen.append(image_pixels())
        assert difference(seen[-1], seen[-2]) > 0.005

    mapping(scene).inputs["Rotation"].default_value = (0, 0, 2.0)
    changed()
    scene.camera.location.z += 0.5
    changed()
    run_object(scene, relightable).rotation_euler = Euler((0.5, 0, pi / 2))
    changed()
    run_object(scene, relightable)["irgspp_albedo_scale"] = (0.5, 1.0, 1.0)
    changed()
    relight_follow.beat()
    assert follower.done  # nothing changed, nothing is asked
    assert bpy.ops.irgspp.relight_stop() == {"FINISHED"}
    assert not preview.preview_running()


class FixedView:
    """A 3D View of 40x20 pixels at the place of the scene's camera, moved up."""

    def __init__(self, scene):
        placed = scene.camera.matrix_world.copy()
        placed.translation.z += 0.5
        depsgraph = bpy.context.evaluated_depsgraph_get()
        self._matrices = SimpleNamespace(
            view_matrix=placed.inverted(), window_matrix=scene.camera.calc_matrix_camera(depsgraph, x=40, y=20)
        )

    def region_3d(self):
        return self._matrices

    def size(self):
        return 40, 20


def test_a_running_preview_follows_resolution_and_point_of_view(scene, relightable, monkeypatch):
    settings = scene.irgspp
    settings.relight_eye, settings.preview_resolution = "camera", 48
    monkeypatch.setattr(preview, "_View", lambda area: FixedView(scene))
    follower = preview.start_preview(scene, relightable, {"samples": 4})
    follow_until(lambda: follower.done)
    sizes = [tuple(bpy.data.images[preview.IMAGE].size)]
    for name, value in (("preview_resolution", 24), ("relight_eye", "view")):
        setattr(settings, name, value)
        relight_follow.beat()  # asks for the new image; a fast engine may have answered already
        follow_until(lambda: follower.done)
        sizes.append(tuple(bpy.data.images[preview.IMAGE].size))
    assert [max(size) for size in sizes] == [48, 24, 24] and sizes[2] == (24, 12) != sizes[1]
    fixed = preview.start_preview(scene, relightable, {"samples": 4}, 32, "camera")
    follow_until(lambda: fixed.done)
    settings.preview_resolution = 16
    relight_follow.beat()
    assert fixed.done  # a script's own values stay


def test_a_ground_shadow_that_a_script_switches_on_is_followed(scene, relightable):
    """Blender reports no change of the scene then."""
    follower = started(scene, relightable)
    follow_until(lambda: follower.done)
    before = follower._requested
    scene.irgspp.ground_shadow = True
    relight_follow.beat()
    assert follower._requested != before


def test_a_rendered_world_comes_later_and_the_former_light_stays_meanwhile(scene, relightable):
    follower = started(scene, relightable)
    follow_until(lambda: follower.done)
    before = image_pixels()
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    background = next(node for node in nodes if node.bl_idname == "ShaderNodeBackground")
    value = nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0.25
    links.new(value.outputs[0], background.inputs["Strength"])
    bpy.context.view_layer.update()
    follow_until(lambda: image_pixels()[..., :3].sum() < 0.5 * before[..., :3].sum() and follower.done, 120)
    assert difference(image_pixels()[..., :3] * 4, before[..., :3]) < 0.01


def test_troubles_are_said_in_words(scene, relightable, tmp_path):
    follower = started(scene, relightable)
    texture = next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeTexEnvironment")
    image, texture.image = texture.image, None
    bpy.context.view_layer.update()
    follow_until(lambda: "has no image" in follower.message)
    assert not follower.ended
    texture.image = image  # mended: it goes on
    bpy.context.view_layer.update()
    follow_until(lambda: follower.done and not follower.failed)
    run_object(scene, relightable).scale = (1, 2, 1)
    bpy.context.view_layer.update()
    follow_until(lambda: "stretched" in follower.message)
    run_object(scene, relightable).scale = (1, 1, 1)
    bpy.data.objects.remove(run_object(scene, relightable))
    follow_until(lambda: follower.ended)
    assert "deleted" in follower.message and not preview.preview_running()
    scene.render.engine = "IRGSPP"
    with pytest.raises(RuntimeError, match=r"no reconstructed object|no object of the run"):
        bpy.ops.render.render()


def test_a_worker_that_dies_ends_the_preview_and_the_next_one_has_another(scene, relightable):
    follower = started(scene, relightable)
    follow_until(lambda: follower.done)
    session = relight_session.session_of(relightable)
    session._worker.kill()
    session._worker.wait()
    mapping(scene).inputs["Rotation"].default_value = (0, 0, 1.0)
    again = started(scene, relightable)
    follow_until(lambda: again.done)
    assert relight_session.session_of(relightable) is not session
