# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported Blender cameras project points to the same pixels as the engine's cameras."""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.irgspp_addon.importer.cameras import look_through
from irgspp.irgspp_addon.importer.scene_builder import import_run
from mathutils import Vector


@pytest.mark.parametrize("index", range(3))
def test_points_fall_on_the_same_pixel(run_folder, index):
    bpy.ops.wm.read_homefile(use_empty=True)
    placed = import_run(run_folder).cameras[index]
    camera = load_run_cameras(run_folder / "cameras.json")[index].camera
    scene = bpy.context.scene
    look_through(scene, placed)
    bpy.context.view_layer.update()
    points = np.random.default_rng(index).uniform(-1, 1, (50, 3))
    expected, depth = camera.project(points)
    for point, pixel, z in zip(points, expected, depth, strict=True):
        x, y, away = world_to_camera_view(scene, placed, Vector(point))
        assert np.allclose((x * camera.width, (1 - y) * camera.height), pixel, atol=1e-3)
        assert away == pytest.approx(z, abs=1e-4)


def test_photographs_are_linked_behind_the_view(run_folder):
    bpy.ops.wm.read_homefile(use_empty=True)
    imported = import_run(run_folder)
    for placed, record in zip(imported.cameras, load_run_cameras(run_folder / "cameras.json"), strict=True):
        (background,) = placed.data.background_images
        assert bpy.path.abspath(background.image.filepath) == str(record.image)
        assert tuple(background.image.size) == (record.camera.width, record.camera.height)
        assert placed.data.show_background_images
