# SPDX-License-Identifier: GPL-3.0-or-later
"""The border between photograph and result lies in the camera's frame, and the drawing leaves nothing behind."""

from types import SimpleNamespace

import blender_side  # noqa: F401  (before bpy)
import bpy
import pytest
from irgspp.irgspp_addon.comparison import photograph, split
from irgspp.irgspp_addon.importer.scene_builder import import_run
from mathutils import Matrix


@pytest.fixture
def scene(run_folder):
    """A run, seen through a camera with its photograph."""
    bpy.ops.wm.read_homefile(use_empty=True)
    photograph.register()
    import_run(run_folder)
    scene = bpy.context.scene
    scene.camera = next(thing for thing in scene.objects if thing.type == "CAMERA" and thing.data.background_images)
    yield scene
    photograph.unregister()


@pytest.fixture
def drawn(monkeypatch):
    """What is drawn, without a GPU: the photograph's part and fraction, and whether words follow."""
    calls = []
    monkeypatch.setattr(split, "_draw_photograph", lambda image, part, fraction, behind: calls.append((image, part, fraction)))
    monkeypatch.setattr(split, "_draw_rectangle", lambda rectangle, colour: None)
    monkeypatch.setattr(split, "_draw_words", lambda context, frame, middle: calls.append(middle))
    return calls


def looking_through(scene, monkeypatch, perspective="CAMERA", camera=None):
    """Draw a 3D View of 400 x 300 pixels that looks through the scene's camera, without zoom."""
    lens, size = scene.camera.evaluated_get(bpy.context.evaluated_depsgraph_get()), (400, 300)
    projection = lens.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1])
    view = SimpleNamespace(view_perspective=perspective, perspective_matrix=projection @ lens.matrix_world.normalized().inverted())
    space = SimpleNamespace(use_local_camera=camera is not None, camera=camera)
    context = SimpleNamespace(scene=scene, region=SimpleNamespace(width=size[0], height=size[1]), region_data=view, space_data=space)
    context.preferences = bpy.context.preferences
    monkeypatch.setattr(split, "bpy", SimpleNamespace(context=context))
    split.draw()


def test_the_photograph_fills_the_camera_s_frame_up_to_the_border(scene, drawn, monkeypatch):
    scene.render.resolution_x = scene.render.resolution_y = 100
    scene.camera.data.shift_x = scene.camera.data.shift_y = 0
    scene.irgspp_border = 0.25
    looking_through(scene, monkeypatch)
    (image, part, fraction), middle = drawn
    assert image == scene.camera.data.background_images[0].image and fraction == 0.25
    # The sensor fits the width: 400 pixels, so the square frame reaches 50 pixels beyond the region's 300.
    assert part == pytest.approx((0, -50, 100, 350), abs=0.1) and middle == pytest.approx(100, abs=0.1)


@pytest.mark.parametrize("reason", ["border", "fade", "view", "local camera", "camera", "photograph", "file"])
def test_nothing_is_drawn_without_a_comparison(scene, drawn, monkeypatch, reason):
    scene.irgspp_border = 0.5
    looking_through(scene, monkeypatch)
    assert drawn
    drawn.clear()
    arguments = {}
    if reason == "border":
        scene.irgspp_border = 0.0
    elif reason == "fade":
        scene.irgspp_comparison = "fade"
    elif reason == "view":
        arguments = {"perspective": "PERSP"}
    elif reason == "local camera":
        arguments = {"camera": bpy.data.objects.new("own", bpy.data.cameras.new("own"))}
    elif reason == "camera":
        scene.camera.data.pop("width")
    elif reason == "photograph":
        scene.camera.data.background_images.clear()
    else:
        scene.camera.data.background_images[0].image = bpy.data.images.load(__file__)  # which is no image
    looking_through(scene, monkeypatch, **arguments)
    assert not drawn


def test_a_camera_that_was_removed_ends_the_comparison(scene, drawn, monkeypatch):
    scene.irgspp_border = 0.5
    camera, scene.camera = scene.camera, None
    bpy.data.objects.remove(camera)
    assert photograph.border(scene) == 0


def test_points_behind_the_eye_have_no_frame(scene):
    view = SimpleNamespace(perspective_matrix=Matrix.Diagonal((1.0, 1.0, 1.0, -1.0)))
    assert split.camera_rectangle(scene, SimpleNamespace(width=40, height=30), view) is None


def test_split_puts_the_photograph_behind_the_object(scene):
    shown = scene.camera.data.background_images[0]
    scene.irgspp_comparison = "fade"
    scene.irgspp_photograph = 0.75
    scene.irgspp_comparison = "split"
    assert shown.display_depth == "BACK" and scene.irgspp_photograph == 0


def test_the_handler_is_removed_with_the_extension(monkeypatch):
    handlers = []
    view = SimpleNamespace(
        draw_handler_add=lambda draw, values, region, kind: handlers.append((draw, region, kind)) or handlers[-1],
        draw_handler_remove=lambda handler, region: handlers.remove(handler),
    )
    monkeypatch.setattr(split, "bpy", SimpleNamespace(app=SimpleNamespace(background=False), types=SimpleNamespace(SpaceView3D=view)))
    split.register()
    assert handlers == [(split.draw, "WINDOW", "POST_PIXEL")]
    split.unregister()
    assert not handlers
    split.unregister()  # in background mode there is none
