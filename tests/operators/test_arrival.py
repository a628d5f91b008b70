# SPDX-License-Identifier: GPL-3.0-or-later
"""A result that arrives in a new file is seen at once: framed, without cameras, cube and lamp around it, under a light."""

import bpy
import pytest
from irgspp.irgspp_addon.importer.arrangement import camera_label, cameras_in, cameras_shown, is_default_world
from irgspp.irgspp_addon.importer.object_sphere import BOUND
from irgspp.panels import result
from mathutils import Vector
from recording_layout import draw


@pytest.fixture
def scene(default_scene):
    return default_scene


def view() -> bpy.types.SpaceView3D:
    return next(area for area in bpy.context.screen.areas if area.type == "VIEW_3D").spaces.active


def mesh_of(scene) -> bpy.types.Object:
    return next(thing for thing in scene.objects if thing.type == "MESH" and thing.name != "Cube")


def arrive(run, **options) -> None:
    assert bpy.ops.irgspp.import_run(directory=str(run), arrange=True, **options) == {"FINISHED"}


def test_the_object_is_framed_in_material_preview(scene, run_folder):
    view().region_3d.view_location = (30, 0, 0)
    arrive(run_folder)
    centre = mesh_of(scene).matrix_world @ (sum((Vector(corner) for corner in mesh_of(scene).bound_box), Vector()) / 8)
    assert (view().region_3d.view_location - centre).length < 0.1 and view().region_3d.view_distance < 10
    assert view().shading.type == "MATERIAL"


def test_cameras_and_the_untouched_cube_and_light_are_hidden(scene, run_folder):
    arrive(run_folder)
    assert len(cameras_in(scene)) == 3 and not cameras_shown(scene)
    for name in ("Cube", "Light"):
        assert scene.objects[name].hide_get() and scene.objects[name].hide_render
    assert not mesh_of(scene).hide_get() and scene.objects["Camera"].visible_get()


def test_the_sphere_around_the_object_comes_and_goes_with_the_cameras(scene, run_folder):
    sphere = bpy.data.objects.new("object", None)
    sphere[BOUND] = [0.0, 0.0, 0.0, 1.0]
    scene.collection.objects.link(sphere)
    arrive(run_folder)
    assert sphere.hide_viewport
    bpy.ops.irgspp.show_cameras(show=True)
    assert not sphere.hide_viewport


def test_what_was_changed_stays(scene, run_folder):
    scene.objects["Cube"].location.x = 1.0
    scene.objects["Light"].data.energy = 100.0
    bpy.context.view_layer.update()
    background = next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Strength"].default_value = 2.0
    world = scene.world
    arrive(run_folder)
    assert scene.objects["Cube"].visible_get() and scene.objects["Light"].visible_get() and scene.world == world


def test_the_nearly_black_default_world_gives_way_to_the_recovered_light(scene, run_folder):
    assert is_default_world(scene.world)
    arrive(run_folder)
    assert scene.world.name == f"{mesh_of(scene).name} light"


def test_importing_again_leaves_the_view_alone(scene, run_folder):
    arrive(run_folder)
    bpy.ops.irgspp.show_cameras(show=True)
    view().region_3d.view_location, view().shading.type = (30, 0, 0), "SOLID"
    arrive(run_folder)
    assert cameras_shown(scene) and view().shading.type == "SOLID" and view().region_3d.view_location.x == 30


def test_scripts_get_the_object_alone(scene, run_folder):
    world = scene.world
    assert bpy.ops.irgspp.import_run(directory=str(run_folder)) == {"FINISHED"}
    assert scene.world == world and cameras_shown(scene) and scene.objects["Cube"].visible_get()


def test_photographs_one_after_the_other(scene, run_folder):
    arrive(run_folder)
    cameras = cameras_in(scene)
    seen = []
    for step in (1, 1, 1, 1, -1):
        assert bpy.ops.irgspp.step_photograph(step=step) == {"FINISHED"}
        seen.append(scene.camera)
        assert [camera for camera in cameras if not camera.hide_viewport] == [scene.camera]  # else Blender draws no photograph
    assert seen == [cameras[0], cameras[1], cameras[2], cameras[0], cameras[2]]
    assert not cameras_shown(scene)


def test_a_camera_is_labelled_without_the_number_that_blender_added(scene, run_folder):
    arrive(run_folder)
    camera = cameras_in(scene)[0]
    name = camera.name
    for given, label in ((name, name), (f"{name}.001", name), (f"{name}.mine", f"{name}.mine"), ("mine.001", "mine.001")):
        camera.name = given
        assert camera_label(camera) == label


def test_the_panel_has_the_switch_and_the_steps(scene, run_folder):
    (run_folder / "run.json").write_text('{"status": "done", "training": {}, "skipped": []}')
    try:
        assert not draw(result.IRGSPP_PT_result).buttons("irgspp.show_cameras")
        assert not bpy.ops.irgspp.step_photograph.poll()
        arrive(run_folder)
        (switch,) = draw(result.IRGSPP_PT_result).buttons("irgspp.show_cameras")
        assert (switch.text, switch.values) == ("Show Cameras", {"show": True})
        bpy.ops.irgspp.show_cameras(**switch.values)
        assert draw(result.IRGSPP_PT_result).buttons("irgspp.show_cameras")[0].text == "Hide Cameras"
        bpy.ops.irgspp.step_photograph()
        assert scene.camera.name in [step.text for step in draw(result.IRGSPP_PT_result).buttons("irgspp.step_photograph")]
    finally:
        (run_folder / "run.json").unlink()
