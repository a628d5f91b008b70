# SPDX-License-Identifier: GPL-3.0-or-later
"""The .blend of a run: complete, portable, and written by a separate process."""

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from irgspp.core.assets.blend_file import write_blend
from irgspp.core.assets.export import export
from irgspp.core.assets.options import AssetOptions
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.machine import blender_process as blending
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.irgspp_addon.importer.cameras import look_through
from irgspp.irgspp_addon.importer.materials import available_sources, source_of
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.run_frame import frame_of, run_object, scene_camera
from irgspp.irgspp_addon.importer.run_root import run_of
from mathutils import Matrix


@pytest.fixture(scope="module")
def blend(run_folder):
    target = run_folder / "scene.blend"
    write_blend(run_folder, target, "textures", Silent())
    return target


def test_blend_opens_with_light_cameras_and_packed_textures(blend):
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    assert scene.view_settings.view_transform == "Standard"
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48)
    assert scene.camera.name == "train view0"
    assert len([o for o in scene.objects if o.type == "CAMERA"]) == 3
    (mesh,) = [o for o in scene.objects if o.type == "MESH"]
    assert source_of(mesh.active_material) == "textures"
    assert available_sources(mesh.active_material) == ["textures", "attributes"]  # the other source can be chosen
    assert [n.bl_idname for n in scene.world.node_tree.nodes].count("ShaderNodeTexEnvironment") == 1
    packed = {image.name: image.packed_file is not None for image in bpy.data.images}
    assert packed == {"albedo.png": True, "roughness.png": True, "metallic.png": True, "normal.png": True, "environment.exr": True} | {
        f"view{i}.png": False for i in range(3)
    }


def test_the_object_stands_on_its_foot_and_photographs_still_fit(blend, run_folder):
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    (mesh,) = [thing for thing in scene.objects if thing.type == "MESH"]
    np.testing.assert_allclose(mesh.matrix_world, np.eye(4), atol=1e-6)
    low = np.min([mesh.matrix_world @ vertex.co for vertex in mesh.data.vertices], axis=0)
    assert abs(low[2]) < 1e-6
    assert_photographs_fit(scene, mesh, run_folder)


def assert_photographs_fit(scene, mesh, run_folder):
    """Check that each camera sees the vertices at the pixels of the run's camera."""
    vertex = read_ply(run_folder / "mesh.ply")["vertex"]
    own = np.stack([vertex[axis] for axis in "xyz"], -1)[::37].astype(float)
    frame = frame_of(mesh)
    for record in load_run_cameras(run_folder / "cameras.json"):
        placed = scene.objects[f"{record.split} {record.name}"]
        look_through(scene, placed)
        size = scene.render.resolution_x, scene.render.resolution_y
        depsgraph = bpy.context.evaluated_depsgraph_get()
        seen = scene_camera(scene, depsgraph, *size, frame)
        in_world = own @ frame.matrix[:3, :3].T + frame.matrix[:3, 3]
        np.testing.assert_allclose(seen.project(in_world)[0], record.camera.project(own)[0], atol=0.02)


def test_one_camera_is_shown_and_views_look_at_the_object(blend):
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    assert [thing.name for thing in scene.objects if thing.type == "CAMERA" and not thing.hide_viewport] == [scene.camera.name]
    views = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
    assert views and all(np.allclose(view.region_3d.view_location, (0, 0, 1), atol=0.01) for view in views)


def test_turned_and_scaled_with_its_cameras_and_light(run_folder, tmp_path):
    turn = 2 * np.array(Matrix.Rotation(np.pi / 2, 3, "X"))
    write_blend(run_folder, tmp_path / "a.blend", "textures", Silent(), ["--transform=" + ",".join(map(str, turn.reshape(-1)))])
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    (mesh,) = [thing for thing in scene.objects if thing.type == "MESH"]
    low = np.min([mesh.matrix_world @ vertex.co for vertex in mesh.data.vertices], axis=0)
    np.testing.assert_allclose(low, [-2, -2, 0], atol=0.02)
    assert_photographs_fit(scene, mesh, run_folder)
    mapping = next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeMapping")
    np.testing.assert_allclose(mapping.inputs["Rotation"].default_value, [-np.pi / 2, 0, 0], atol=1e-5)


@pytest.mark.parametrize(("transform", "words"), [((1, 0, 0, 0, 2, 0, 0, 0, 1), "stretches"), ((-1, 0, 0, 0, 1, 0, 0, 0, 1), "mirrors")])
def test_what_a_blend_can_not_be(run_folder, tmp_path, transform, words):
    with pytest.raises(InputError, match=words):
        export(run_folder, tmp_path / "a.blend", options=AssetOptions(transform=transform))


def test_paths_are_relative_and_lead_to_the_files(blend):
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    for image in bpy.data.images:
        assert image.filepath.startswith("//")
        assert image.has_data or tuple(image.size) != (0, 0)
    assert bpy.data.images["environment.exr"].filepath == "//environment.exr"


def test_export_by_suffix(run_folder, tmp_path):
    export(run_folder, tmp_path / "light.exr")
    assert (tmp_path / "light.exr").read_bytes() == (run_folder / "environment.exr").read_bytes()
    export(run_folder, tmp_path / "scene.blend", "attributes")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert [source_of(o.active_material) for o in bpy.data.objects if o.type == "MESH"] == ["attributes"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["light.exr", "scene.blend"]


def write_library(run: Path, target: Path, textures: str) -> None:
    """Write a run's .blend with this Blender, as the engine does: textures packed, or in a folder beside it."""
    additions = []
    if textures == "beside":
        shutil.copytree(run / "textures", target.with_name("ball_textures"))
        additions = ["--textures", str(target.with_name("ball_textures"))]
    write_blend(run, target, "textures", Silent(), additions)


@pytest.mark.parametrize("textures", ["packed", "beside"])
@pytest.mark.parametrize("link", [False, True], ids=["appended", "overridden"])
def test_the_collection_is_complete_in_a_file_of_another_folder(run_folder, tmp_path, textures, link):
    library, user = tmp_path / "library" / "ball.blend", tmp_path / "shots" / "one" / "shot.blend"
    library.parent.mkdir()
    user.parent.mkdir(parents=True)
    write_library(run_folder, library, textures)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(user))
    with bpy.data.libraries.load(str(library), link=link, relative=True) as (source, wanted):
        wanted.collections = [name for name in source.collections if not name.endswith("cameras")]
        wanted.worlds = source.worlds
    (collection,), (world,) = wanted.collections, wanted.worlds
    scene, world.use_fake_user = bpy.context.scene, True
    if link:
        collection.override_hierarchy_create(scene, bpy.context.view_layer, do_fully_editable=True)
    else:
        scene.collection.children.link(collection)
    scene.world = world
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(user))
    (mesh,) = [thing for thing in bpy.context.scene.objects if thing.type == "MESH" and (thing.override_library is not None) == link]
    images = [node.image for node in mesh.active_material.node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"]
    light = next(node.image for node in bpy.context.scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeTexEnvironment")
    assert [tuple(image.size) for image in images] == [(128, 128)] * 4 and light.size[0] > 0
    assert all((image.packed_file is not None) == (textures == "packed") for image in images)
    assert run_of(mesh) == run_folder and run_object(bpy.context.scene, run_folder) is not None


@pytest.mark.parametrize("name", ["a.stl", "a", "missing/a.blend"])
def test_bad_exports_are_errors(run_folder, tmp_path, name):
    with pytest.raises(InputError):
        export(run_folder, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_bad_run_is_reported_in_one_line(run_folder, tmp_path):
    (tmp_path / "mesh.ply").write_bytes((run_folder / "mesh.ply").read_bytes())
    with pytest.raises(InputError, match=r"cameras\.json.*can't be read") as caught:
        write_blend(tmp_path, tmp_path / "scene.blend", "textures", Silent())
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "scene.blend").exists()


def test_cancelling_stops_the_process(run_folder, tmp_path):
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        write_blend(run_folder, tmp_path / "scene.blend", "textures", progress)
    assert not list(tmp_path.iterdir())


def test_without_blender(run_folder, tmp_path, monkeypatch):
    monkeypatch.setattr(blending.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(IrgsppError, match="bpy"):
        write_blend(run_folder, tmp_path / "scene.blend", "textures", Silent())


def test_failing_process_is_an_error(run_folder, tmp_path, monkeypatch):
    (tmp_path / "launch.py").write_text("raise SystemExit('out of luck')")
    monkeypatch.setattr(blending, "LAUNCHER", tmp_path / "launch.py")
    with pytest.raises(IrgsppError, match=r"status 1: out of luck"):
        write_blend(run_folder, tmp_path / "scene.blend", "textures", Silent())
