# SPDX-License-Identifier: GPL-3.0-or-later
"""What the render engine does not draw is said: lamps with nodes, other objects, a second reconstruction, collection instances."""

import shutil

import bpy
import pytest
from irgspp.irgspp_addon.relight.left_out import left_out
from irgspp.irgspp_addon.relight.world_follower import changes
from irgspp.panels import relight, run_state
from recording_layout import draw


@pytest.fixture
def scene(default_scene, run_folder):
    """Blender's default scene with a run, arranged."""
    bpy.ops.irgspp.import_run(directory=str(run_folder), arrange=True)
    return default_scene


def text(scene, run, final=False) -> str:
    bpy.context.view_layer.update()
    changes.note()
    return left_out(scene, bpy.context.view_layer, run.resolve() if run else None, final)


def add_falloff(lamp) -> None:
    """Give a lamp nodes that the engine does not know."""
    lamp.data.use_nodes = True
    tree = lamp.data.node_tree
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    tree.links.new(tree.nodes.new("ShaderNodeLightFalloff").outputs[0], emission.inputs["Strength"])


def test_nothing_is_said_where_everything_is_drawn(scene, run_folder):
    assert text(scene, run_folder) == text(scene, run_folder, final=True) == ""


def test_lamps_and_other_objects(scene, run_folder):
    for name in ("Cube", "Light"):
        scene.objects[name].hide_set(False)
    for _ in range(2):
        bpy.ops.object.light_add(type="SUN")
        add_falloff(bpy.context.object)
    bpy.ops.object.light_add(type="AREA")
    assert text(scene, run_folder) == "Not drawn: 2 lamps with nodes, 1 object"
    scene.objects["Sun"].hide_render = True
    assert text(scene, run_folder, final=True) == "Not drawn: 1 lamp with nodes"  # the cube is still hidden in renders
    scene.irgspp.use_lamps = False
    assert text(scene, run_folder, final=True) == ""


def test_a_second_reconstruction_and_a_collection_instance(scene, run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "second")
    bpy.ops.irgspp.import_run(directory=str(tmp_path / "second"))
    bpy.ops.object.collection_instance_add(collection=bpy.data.objects["Cube"].users_collection[0].name)
    assert text(scene, run_folder) == "Not drawn: 1 other reconstruction, 1 collection instance"


def test_the_panel_says_it(scene, run_folder):
    (run_folder / "run.json").write_text('{"status": "done", "training": {}, "skipped": []}')
    run_state._known.clear()
    try:
        assert "Not drawn" not in draw(relight.IRGSPP_PT_relight).words
        bpy.ops.object.light_add(type="SUN")
        add_falloff(bpy.context.object)
        bpy.context.view_layer.objects.active = next(thing for thing in scene.objects if "sphere" in thing.name and thing.type == "MESH")
        assert text(scene, run_folder)
        assert "Not drawn: 1 lamp with nodes" in draw(relight.IRGSPP_PT_relight).words
    finally:
        (run_folder / "run.json").unlink()
        run_state._known.clear()
