# SPDX-License-Identifier: GPL-3.0-or-later
"""The light is chosen in the panel: an HDRI with rotation and strength, the recovered light, a plain colour."""

from math import pi

import bpy
import numpy as np
import pytest
from blender_side import write_image
from irgspp.irgspp_addon.world.light_controls import light_controls
from irgspp.irgspp_addon.world.plain_world import plain_light
from irgspp.panels import relight
from recording_layout import draw
from relighting import lamp


@pytest.fixture
def scene(default_scene):
    return default_scene


@pytest.fixture
def hdri(tmp_path):
    return write_image(tmp_path / "studio.exr", lamp())


def sockets(world) -> list[str]:
    controls = light_controls(world)
    return [name for name in ("image", "rotation", "colour", "strength") if getattr(controls, name) is not None]


def test_an_hdri_lights_the_scene_with_rotation_and_strength(scene, hdri):
    assert bpy.ops.irgspp.open_hdri(filepath=str(hdri)) == {"FINISHED"}
    controls = light_controls(scene.world)
    controls.rotation.default_value[2], controls.strength.default_value = pi, 2.0
    light = plain_light(scene.world)
    assert light.strength == 2.0
    assert np.abs(light.image(64) - 2 * np.roll(lamp(), 64, 1)).max() < 1e-3


def test_the_next_hdri_keeps_rotation_and_strength_and_leaves_no_world_behind(scene, hdri, tmp_path):
    bpy.ops.irgspp.open_hdri(filepath=str(hdri))
    controls = light_controls(scene.world)
    controls.rotation.default_value[2], controls.strength.default_value = 1.0, 3.0
    bpy.ops.irgspp.open_hdri(filepath=str(write_image(tmp_path / "other.exr", 2 * lamp())))
    controls = light_controls(scene.world)
    assert (scene.world.name, controls.image.name) == ("other", "other.exr")
    assert (controls.rotation.default_value[2], controls.strength.default_value) == (1.0, 3.0)
    assert "studio" not in bpy.data.worlds and "World" in bpy.data.worlds  # a World of the user is kept


@pytest.mark.parametrize(("name", "content", "words"), [("a.txt", b"x", "not an image"), ("a.exr", b"x", "a.exr"), ("", b"", "no such")])
def test_other_files_are_refused(scene, tmp_path, name, content, words):
    path, world, images = tmp_path / (name or "gone.exr"), scene.world, len(bpy.data.images)
    if name:
        path.write_bytes(content)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.irgspp.open_hdri(filepath=str(path))
    assert scene.world == world and len(bpy.data.worlds) == 1 and len(bpy.data.images) == images


def test_the_recovered_light_is_offered(scene, run_folder):
    (run_folder / "run.json").write_text('{"status": "done", "training": {}, "skipped": []}')
    try:
        with pytest.raises(RuntimeError, match="import the run"):
            bpy.ops.irgspp.use_recovered_light(run=str(run_folder))
        bpy.ops.irgspp.import_run(directory=str(run_folder))
        (offer,) = draw(relight.IRGSPP_PT_relight).buttons("irgspp.use_recovered_light")
        assert bpy.ops.irgspp.use_recovered_light(**offer.values) == {"FINISHED"}
        assert scene.world.name == "sphere light"
        drawn = draw(relight.IRGSPP_PT_relight)
        assert not drawn.buttons("irgspp.use_recovered_light") and drawn.properties.count("default_value") == 2
    finally:
        (run_folder / "run.json").unlink()


def test_controls_of_other_worlds(scene):
    assert sockets(scene.world) == ["colour", "strength"]
    assert sockets(None) == []
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    background = next(node for node in nodes if node.bl_idname == "ShaderNodeBackground")
    links.new(nodes.new("ShaderNodeTexSky").outputs["Color"], background.inputs["Color"])
    assert sockets(scene.world) == ["strength"]
    nodes.new("ShaderNodeBackground")
    assert sockets(scene.world) == []  # which of the two?


def test_a_chosen_light_is_seen_in_material_preview(scene, hdri):
    (shading,) = [area.spaces.active.shading for area in bpy.context.window.screen.areas if area.type == "VIEW_3D"]
    shading.type, shading.use_scene_world = "SOLID", False
    bpy.ops.irgspp.open_hdri(filepath=str(hdri))
    assert not shading.use_scene_world  # the view of a modeller stays
    shading.type = "MATERIAL"
    bpy.ops.irgspp.open_hdri(filepath=str(hdri))
    assert shading.use_scene_world
