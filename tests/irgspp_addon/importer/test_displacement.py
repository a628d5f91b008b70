# SPDX-License-Identifier: GPL-3.0-or-later
"""Height texture of a run in Blender: nodes that change nothing until they are linked, and displacement by the right distance."""

import json
import shutil

import bpy
import irgspp
import numpy as np
import pytest
from cycles_layers import render
from irgspp.core.errors import InputError
from irgspp.irgspp_addon.importer.displacement import displace, displaces, has_displacement
from irgspp.irgspp_addon.importer.scene_builder import import_run
from mathutils import Vector


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_homefile(use_empty=True)


def save_heights(run, value: float) -> None:
    """Write a height texture of one value, 0..1, with Blender's own 16-bit writer."""
    image = bpy.data.images.new("heights", 8, 8, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.full(256, value, np.float32))
    scene = bpy.context.scene
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "PNG", "16"
    scene.render.image_settings.color_mode, scene.view_settings.view_transform = "BW", "Raw"
    image.save_render(str(run / "textures" / "height.png"), scene=scene)
    bpy.data.images.remove(image)


@pytest.fixture
def run(run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    save_heights(run, 0.75)
    (run / "run.json").write_text(json.dumps({"height": {"scale": 0.4, "midlevel": 0.5, "missed": 0.0}}))
    return run


def test_nodes_are_there_and_change_nothing_until_linked(run):
    material = import_run(run).mesh.active_material
    nodes = material.node_tree.nodes
    assert has_displacement(material) and not displaces(material) and material.displacement_method == "BUMP"
    assert not nodes["Material Output"].inputs["Displacement"].is_linked
    image, node = nodes["height texture"].image, nodes["displacement"]
    assert image.colorspace_settings.name == "Non-Color" and image.packed_file is not None
    assert abs(image.pixels[0] - 0.75) < 1e-3
    assert [round(node.inputs[name].default_value, 6) for name in ("Scale", "Midlevel")] == [0.4, 0.5]
    displace(material, True)
    assert displaces(material) and material.displacement_method == "DISPLACEMENT"
    displace(material, False)
    assert not displaces(material) and material.displacement_method == "BUMP"


def test_run_without_heights_has_no_nodes_and_no_switch(run_folder):
    material = import_run(run_folder).mesh.active_material
    assert not has_displacement(material) and not displaces(material)
    irgspp.register()
    try:
        material.irgspp_displace = True
        assert not material.irgspp_displace and material.displacement_method == "BUMP"
    finally:
        irgspp.unregister()


def test_heights_without_their_scale_are_an_error(run):
    (run / "run.json").write_text("{}")
    with pytest.raises(InputError, match=r"run\.json: lacks the scale of textures/height\.png .*bake the run again"):
        import_run(run)


def test_cycles_displaces_by_the_height(run, tmp_path):
    """The outline of the unit sphere grows by scale * (value - midlevel) = .1, in an orthographic view 4 units wide."""
    imported, scene = import_run(run), bpy.context.scene
    scene.camera = bpy.data.objects.new("above", bpy.data.cameras.new("above"))
    scene.collection.objects.link(scene.camera)
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4.0
    scene.camera.location = imported.mesh.matrix_world.translation + Vector((0, 0, 5))
    scene.render.resolution_x = scene.render.resolution_y = 128
    scene.render.film_transparent = True
    radii = []
    for on in (False, True):
        displace(imported.mesh.active_material, on)
        covered = render(scene, tmp_path / f"{on}.exr", 4)[..., 3].mean()
        radii.append(np.sqrt(16 * covered / np.pi))
    assert radii[0] == pytest.approx(1, abs=0.02) and radii[1] - radii[0] == pytest.approx(0.1, abs=0.01)
