# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished run baked again and exported from Blender, with the real engine."""

import json
import shutil
import subprocess

import bpy
import irgspp
import numpy as np
import pytest
from blender_side import ROOT, warm
from engine_jobs import finished_run, leave_finished, reconstruction
from irgspp.irgspp_addon.importer.edited_mesh import save_edited
from irgspp.irgspp_addon.importer.materials import source_of
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.run_frame import frame_of, run_object
from irgspp.irgspp_addon.jobs import queue as jobs
from mathutils import Matrix


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run that took seconds, made here unless a test has left it."""
    if finished_run(tmp_path_factory).exists():
        return finished_run(tmp_path_factory)
    run = tmp_path_factory.mktemp("finished") / "tiny"
    command = [warm(), str(ROOT / "irgspp_addon" / "launch.py"), "__main__", *reconstruction(run)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    leave_finished(run, tmp_path_factory)
    return run


@pytest.fixture
def run(finished, tmp_path, monkeypatch):
    """A copy of it, imported by the registered extension into an empty file."""
    monkeypatch.setenv("IRGSPP_PYTHON", warm())
    run = shutil.copytree(finished, tmp_path / "tiny").resolve()
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    bpy.ops.irgspp.import_run(directory=str(run))
    yield run
    irgspp.unregister()


def texture_size() -> int:
    (size,) = {node.image.size[0] for node in bpy.data.materials["tiny"].node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"}
    return size


def triangles(thing) -> int:
    return sum(len(polygon.vertices) - 2 for polygon in thing.data.polygons)


def test_other_size_and_fewer_triangles_come_into_the_scene_from_a_job(run):
    """With heights, which wait for the switch."""
    thing, blocks, material = bpy.data.objects["tiny"], len(bpy.data.images), bpy.data.materials["tiny"]
    material.irgspp_source = "attributes"
    assert texture_size() == 64 and triangles(thing) > 100
    assert bpy.ops.irgspp.bake(size=32, bits="16", triangles=100, height=True, wait=False) == {"FINISHED"}  # of the active object's run
    job = jobs.wait(jobs.all_jobs()[0], timeout=300)
    assert (job.kind, job.state, job.error) == ("bake", "done", None)
    assert texture_size() == 32 and len(bpy.data.images) == blocks + 1  # the heights
    assert bpy.data.objects["tiny"] == thing and source_of(thing.active_material) == "attributes"
    assert triangles(thing) <= 100
    baked = json.loads((run / "run.json").read_text())["baked"]
    assert (baked["texture"], baked["bits"]) == (32, 16)
    nodes = bpy.data.materials["tiny"].node_tree.nodes
    assert all(nodes[f"{name} texture"].image.is_float for name in ("albedo", "roughness", "metallic", "normal"))  # which 8 bits are not
    scale = json.loads((run / "run.json").read_text())["height"]["scale"]
    node = nodes["displacement"]
    assert node.inputs["Scale"].default_value == pytest.approx(scale, rel=1e-5) and not material.irgspp_displace
    material.irgspp_displace = True
    assert node.outputs["Displacement"].is_linked and material.displacement_method == "DISPLACEMENT"


def test_smaller_textures_come_from_the_bake_and_the_bake_comes_back(run):
    albedo = (run / "textures" / "albedo.png").read_bytes()
    for size, kept in ((32, True), (64, False)):
        assert bpy.ops.irgspp.bake(run=str(run), size=size) == {"FINISHED"}
        assert texture_size() == size and (run / "textures" / "baked").is_dir() == kept
        state = json.loads((run / "run.json").read_text())
        assert (state["textures"]["size"], state["textures"]["baked"]) == (size, 64) and "baked" not in state
    assert (run / "textures" / "albedo.png").read_bytes() == albedo


def test_edited_object_becomes_the_result(run):
    """Modifiers and the object's own transform are applied to the mesh once, those of its parent empty never."""
    thing = bpy.data.objects["tiny"]
    thing.parent.matrix_world = Matrix.Translation((5, 0, 0)) @ Matrix.Rotation(1.0, 4, "X") @ Matrix.Scale(3, 4)
    thing.location.z = 0.02
    thing.modifiers.new("fewer", "DECIMATE").ratio = 0.5
    bpy.context.view_layer.update()
    shown = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    count, before = len(shown.data.polygons), bounds(shown)
    assert bpy.ops.irgspp.bake(mesh="tiny") == {"FINISHED"}
    bpy.context.view_layer.update()
    assert triangles(thing) == count and not thing.modifiers
    assert np.allclose(bounds(thing), before, atol=1e-4)
    assert np.allclose(frame_of(thing).matrix, np.array(thing.parent.matrix_world), atol=1e-5) and texture_size() == 64


def test_run_becomes_quads(run):
    assert bpy.ops.irgspp.bake(run=str(run), quads=150) == {"FINISHED"}
    thing = bpy.data.objects["tiny"]
    assert {len(polygon.vertices) for polygon in thing.data.polygons} == {4} and 75 < len(thing.data.polygons) < 300
    assert not thing.data.validate() and texture_size() == 64
    mirrored = [polygon for polygon in thing.data.polygons if uv_area(thing.data, polygon) <= 0]
    assert len(mirrored) <= 0.02 * len(thing.data.polygons)  # QuadriFlow folds a few at sharp corners


def uv_area(mesh, polygon) -> float:
    u, v = np.array([mesh.uv_layers.active.uv[loop].vector for loop in polygon.loop_indices]).T
    return float((u * np.roll(v, -1) - v * np.roll(u, -1)).sum() / 2)


def bounds(thing) -> np.ndarray:
    corners = np.array([thing.matrix_world @ vertex.co for vertex in thing.data.vertices])
    return np.stack([corners.min(0), corners.max(0)])


def test_object_made_anew_gives_the_run_its_shape(run):
    thing = bpy.data.objects["tiny"]
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1.2, segments=16, ring_count=8)
    ball = bpy.context.object
    assert bpy.ops.irgspp.bake(run=str(run), mesh=ball.name, size=64) == {"FINISHED"}
    assert triangles(thing) == triangles(ball) == 16 * 8 * 2 - 32
    assert len(thing.data.polygons) == len(ball.data.polygons)  # the quads are quads again
    assert ball.active_material == thing.active_material
    assert len(ball.data.vertices) == len(thing.data.vertices)  # sewn together again


def test_saved_mesh_is_in_the_runs_frame_and_right_side_out(run):
    bpy.data.objects["tiny"].parent.location = (1, 2, 3)
    bpy.ops.mesh.primitive_cube_add(size=2, location=(1, 2, 3))
    cube = bpy.context.object
    cube.scale.x = -2
    elements = read_ply(save_edited(bpy.context, cube, run))
    vertex = elements["vertex"]
    place = np.stack([vertex[name] for name in "xyz"], -1)
    assert np.allclose(place.min(0), (-2, -1, -1)) and np.allclose(place.max(0), (2, 1, 1))
    corner = place[elements["face"]["vertex_indices"]]
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert ((facing * corner.mean(1)).sum(-1) > 0).all()
    normal = np.stack([vertex[name] for name in ("nx", "ny", "nz")], -1)[elements["face"]["vertex_indices"][:, 0]]
    assert np.allclose(np.linalg.norm(normal, axis=-1), 1, atol=1e-4) and ((normal * facing).sum(-1) > 0).all()


@pytest.mark.parametrize("suffix", [".ply", ".exr", ".blend"])  # .glb is exported and imported again below
def test_export(run, tmp_path, suffix):
    target = tmp_path / f"out{suffix}"
    assert bpy.ops.irgspp.export(run=str(run), filepath=str(target)) == {"FINISHED"}
    assert target.stat().st_size > 1000


def test_exports_are_turned_and_scaled_as_the_object(run, tmp_path):
    scene = bpy.context.scene
    thing = run_object(scene, run)
    high = max(vertex.co.z for vertex in thing.data.vertices)
    thing.scale = (2, 2, 2)
    thing.location.x += 5
    for chosen, factor in (({}, 2), ({"as_placed": False}, 1)):
        bpy.ops.irgspp.export(run=str(run), filepath=str(tmp_path / "a.glb"), **chosen)
        height = read_height(tmp_path / "a.glb")
        assert abs(height / (factor * high) - 1) < 1e-4
    thing.scale = (2, 1, 1)
    for suffix in (".blend", ".ply"):
        with pytest.raises(RuntimeError, match="stretches the object"):
            bpy.ops.irgspp.export(run=str(run), filepath=str(tmp_path / f"a{suffix}"))
    assert bpy.ops.irgspp.export(run=str(run), filepath=str(tmp_path / "light.exr")) == {"FINISHED"}


def read_height(path) -> float:
    """Return the top of an object in a .glb that stands on its foot."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path))
    bpy.context.view_layer.update()
    new = [thing for thing in set(bpy.data.objects) - before if thing.type == "MESH"]
    return max((thing.matrix_world @ vertex.co).z for thing in new for vertex in thing.data.vertices)


def test_export_for_other_programs_with_levels_and_textures_beside(run, tmp_path):
    target = tmp_path / "chair.fbx"
    chosen = {"lods": True, "collision": True, "textures": "beside", "normal_map": "directx"}
    assert bpy.ops.irgspp.export(run=str(run), filepath=str(target), **chosen) == {"FINISHED"}
    names = sorted(path.name for path in (tmp_path / "chair_textures").iterdir())
    materials = ["albedo.png", "metallic.png", "normal.png", "orm.png", "roughness.png"]
    assert names == sorted([*materials, "confidence.png", "material_confidence.png"])
    before = set(bpy.data.objects)
    bpy.ops.import_scene.fbx(filepath=str(target))
    found = {thing.name for thing in set(bpy.data.objects) - before}
    assert {"chair_LOD0", "chair_LOD1", "chair_LOD2", "UCX_chair_LOD0_00"} <= found
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith((".", "chair"))) == ["chair.fbx", "chair_textures"]


def test_bad_requests_are_errors_in_words(run, tmp_path):
    bpy.data.objects.new("nothing", None)
    bpy.ops.object.empty_add()
    for call, words in [
        (lambda: bpy.ops.irgspp.bake(run=str(tmp_path)), "is not a run folder"),
        (lambda: bpy.ops.irgspp.bake(run=str(run), mesh="none"), "no such object in the scene"),
        (lambda: bpy.ops.irgspp.bake(run=str(run), mesh=bpy.context.object.name), "is not a mesh"),
        (lambda: bpy.ops.irgspp.bake(run=str(run), size=3), "surface.texture"),
        (lambda: bpy.ops.irgspp.export(run=str(run)), "no file is named"),
        (lambda: bpy.ops.irgspp.export(run=str(run), filepath=str(tmp_path / "a.stl")), "can't export to .stl"),
        (lambda: bpy.ops.irgspp.export(filepath=str(tmp_path / "a.glb")), "select the imported object"),
    ]:
        with pytest.raises(RuntimeError, match=words) as caught:
            call()
        assert str(caught.value).count("\n") == 1
    shutil.rmtree(run)
    bpy.context.view_layer.objects.active = bpy.data.objects["tiny"]
    with pytest.raises(RuntimeError, match="it may have been moved"):
        bpy.ops.irgspp.bake()
