# SPDX-License-Identifier: GPL-3.0-or-later
"""The .blend of a run: complete, portable, and written by a separate process."""

import shutil
from pathlib import Path

import bpy
import pytest
from irgspp.core.assets.blend_file import write_blend
from irgspp.core.assets.export import export
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.machine import blender_process as blending
from irgspp.core.progress.protocol import Silent
from irgspp.irgspp_addon.importer.materials import available_sources, source_of
from irgspp.irgspp_addon.importer.run_frame import run_object
from irgspp.irgspp_addon.importer.run_root import run_of


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
