# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment maps have the same orientation in Blender's world as in the engine's frame."""

import bpy
import numpy as np
import pytest
from blender_side import read_image, write_image
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.irgspp_addon.importer.cameras import look_through
from irgspp.irgspp_addon.importer.scene_builder import import_run, show_as_photographed
from irgspp.irgspp_addon.world.light_to_world import bake_world, world_from_map
from sphere_run import map_directions


def look_up(light: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the nearest texels (..., 3) of a lat-long map (H, W, 3) in directions (..., 3), in the engine's convention."""
    d = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    u, v = 0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi), np.arccos(d[..., 2].clip(-1, 1)) / np.pi
    height, width = light.shape[:2]
    return light[np.minimum((v * height).astype(int), height - 1), (u * width).astype(int) % width]


@pytest.mark.parametrize("index", range(3))
def test_background_shows_the_texels_in_the_directions_of_the_cameras_rays(run_folder, tmp_path, index):
    bpy.ops.wm.read_homefile(use_empty=True)
    imported = import_run(run_folder)
    scene = bpy.context.scene
    show_as_photographed(scene, imported)
    look_through(scene, imported.cameras[index])
    imported.mesh.hide_render = True
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(tmp_path / "view.exr")
    bpy.ops.render.render(write_still=True)
    camera = load_run_cameras(run_folder / "cameras.json")[index].camera
    expected = look_up(read_image(run_folder / "environment.exr"), camera.rays().astype(float))
    rendered = read_image(tmp_path / "view.exr")
    assert rendered.shape == expected.shape
    assert np.abs(rendered - expected).max() < 0.04  # texels differ by up to 0.03; a wrong axis makes 0.5
    assert np.abs(rendered - expected).mean() < 0.01


def test_any_world_is_baked_in_the_engines_convention(tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True)
    light = (0.5 + 0.4 * map_directions(32, 64)).astype(np.float32)
    write_image(tmp_path / "light.exr", light)
    world = bpy.context.scene.world = world_from_map(tmp_path / "light.exr")
    nodes = world.node_tree.nodes
    next(n for n in nodes if n.bl_idname == "ShaderNodeBackground").inputs["Strength"].default_value = 2.0
    next(n for n in nodes if n.bl_idname == "ShaderNodeMapping").inputs["Rotation"].default_value = (0, 0, np.pi / 2)
    bake_world(bpy.context.scene, tmp_path / "baked.exr", 32)
    d = map_directions(32, 64)
    turned = np.stack([-d[..., 1], d[..., 0], d[..., 2]], -1)  # the lookup along +X returns the texel of +Y
    assert np.allclose(read_image(tmp_path / "baked.exr"), 2 * (0.5 + 0.4 * turned), atol=0.01)
    assert len(bpy.data.scenes) == 1
