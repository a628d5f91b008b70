# SPDX-License-Identifier: GPL-3.0-or-later
"""A run is imported as an ordinary object, and Cycles reads the right values from its materials."""

import json
import shutil

import bpy
import numpy as np
import pytest
import sphere_run
from blender_side import write_sphere_run
from cycles_layers import glowing_inputs
from irgspp.core.errors import InputError
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.irgspp_addon.importer.materials import available_sources, source_of, use_source
from irgspp.irgspp_addon.importer.placement import Placement
from irgspp.irgspp_addon.importer.ply import read_ply
from irgspp.irgspp_addon.importer.run_root import run_of
from irgspp.irgspp_addon.importer.scene_builder import import_run, show_as_photographed
from mathutils import Euler, Matrix


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_homefile(use_empty=True)


FOOT = np.float32([0, 0, -1])  # of the unit sphere


def test_ply_reader_reads_the_engines_mesh(run_folder):
    elements, mesh = read_ply(run_folder / "mesh.ply"), sphere_run.sphere()
    assert np.array_equal(elements["face"]["vertex_indices"], mesh.faces)
    assert np.array_equal(elements["vertex"]["albedo_g"], mesh.albedo[:, 1])


@pytest.mark.parametrize("damage", [lambda b: b[:-5], lambda b: b[:40], lambda b: b.replace(b"little", b"big"), lambda b: b""])
def test_broken_ply_is_bad_input(run_folder, tmp_path, damage):
    (tmp_path / "mesh.ply").write_bytes(damage((run_folder / "mesh.ply").read_bytes()))
    with pytest.raises(InputError, match=r"mesh\.ply"):
        read_ply(tmp_path / "mesh.ply")


def test_mesh_is_welded_and_keeps_uvs_normals_and_attributes(run_folder):
    mesh = import_run(run_folder).mesh.data
    source = sphere_run.sphere()
    assert not mesh.validate()
    assert len(mesh.polygons) == len(source.faces)
    assert len(mesh.vertices) == len(np.unique(source.vertices, axis=0)) < len(source.vertices)
    corners = source.faces.reshape(-1)
    uv, normal = np.empty(2 * len(corners), np.float32), np.empty(3 * len(corners), np.float32)
    mesh.uv_layers.active.data.foreach_get("uv", uv)
    mesh.corner_normals.foreach_get("vector", normal)
    assert np.array_equal(uv.reshape(-1, 2), source.uvs[corners])
    assert np.allclose(normal.reshape(-1, 3), source.normals[corners], atol=1e-3)
    place = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", place)
    expected = sphere_run.materials(place.reshape(-1, 3) + FOOT)
    for name, key, size, values in [("albedo", "color", 4, expected[0]), ("roughness", "value", 1, expected[1])]:
        stored = np.empty(size * len(mesh.vertices), np.float32)
        mesh.attributes[name].data.foreach_get(key, stored)
        assert np.allclose(stored.reshape(len(values), -1)[:, :3].reshape(values.shape), values, atol=1e-6)


def test_confidence_of_the_mesh_is_an_attribute(run_folder, tmp_path):
    mesh = import_run(write_sphere_run(tmp_path / "run", confidence=True)).mesh.data
    place, stored = np.empty(3 * len(mesh.vertices), np.float32), np.empty(len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", place)
    mesh.attributes["confidence"].data.foreach_get("value", stored)
    height = 0.5 + 0.5 * (place[2::3] + FOOT[2])
    assert np.allclose(stored, height, atol=1e-6)
    colours = np.empty(4 * len(mesh.vertices), np.float32)
    mesh.attributes["material_confidence"].data.foreach_get("color", colours)
    expected = np.stack([height, 1 - height, height**2], -1)
    assert np.allclose(colours.reshape(-1, 4)[:, :3], expected, atol=1e-6)
    assert mesh.color_attributes.active_color.name == "albedo"
    assert not {"confidence", "material_confidence"} & set(import_run(run_folder).mesh.data.attributes.keys())


@pytest.mark.parametrize("source", ["textures", "attributes"])
def test_cycles_reads_the_materials_values(run_folder, tmp_path, source):
    imported = import_run(run_folder, source)
    scene = bpy.context.scene
    show_as_photographed(scene, imported)
    layers = glowing_inputs(scene, imported.mesh.active_material, tmp_path)
    camera = load_run_cameras(run_folder / "cameras.json")[0].camera
    point, hit = first_hit(camera.centre, camera.rays().astype(float))
    inside = hit & (layers["Base Color"][..., 3] > 0.99)
    albedo, roughness, metallic = sphere_run.materials(point)
    away = inside & (np.abs(point[..., 2]) > 0.2)  # from the edge between metal and dielectric
    assert inside.sum() > 400
    assert np.abs(layers["Base Color"][..., :3] - albedo)[inside].mean() < 0.01
    assert np.abs(layers["Roughness"][..., 0] - roughness)[inside].mean() < 0.01
    assert np.abs(layers["Metallic"][..., 0] - metallic)[away].max() < 0.02
    normal = 2 * layers["Normal"][..., :3] - 1
    assert ((normal * point).sum(-1)[inside] / np.linalg.norm(normal, axis=-1)[inside] > 0.999).all()


def first_hit(centre: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first intersections (H, W, 3) of rays (H, W, 3) with the unit sphere, and the mask (H, W) of rays that hit it."""
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ centre
    root = along**2 - centre @ centre + 1
    return centre + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * ray, root > 0


def test_colour_spaces_and_principled(run_folder):
    imported = import_run(run_folder, "textures")
    nodes = imported.mesh.active_material.node_tree.nodes
    spaces = {n.label: n.image.colorspace_settings.name for n in nodes if n.bl_idname == "ShaderNodeTexImage"}
    assert spaces == {"albedo": "sRGB", "roughness": "Non-Color", "metallic": "Non-Color", "normal": "Non-Color"}
    principled = next(n for n in nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    assert principled.distribution == "GGX"
    assert all(principled.inputs[name].is_linked for name in ("Base Color", "Roughness", "Metallic", "Normal"))
    assert principled.inputs["IOR"].default_value == 1.5
    assert imported.world is not bpy.context.scene.world  # importing alone leaves the scene's light as it is


def test_run_without_textures(run_folder, tmp_path):
    for name in ("mesh.ply", "environment.exr", "cameras.json", "reconstruction.json"):
        (tmp_path / name).write_bytes((run_folder / name).read_bytes())
    with pytest.raises(InputError, match=r"albedo\.png"):
        import_run(tmp_path, "textures")
    assert not bpy.data.objects  # no incomplete import is left
    material = import_run(tmp_path, "attributes").mesh.active_material
    assert source_of(material) == "attributes" and available_sources(material) == ["attributes"]
    with pytest.raises(InputError, match="no nodes for textures"):
        use_source(material, "textures")
    assert source_of(material) == "attributes"


def test_folder_that_is_not_a_run(tmp_path):
    with pytest.raises(InputError, match=r"cameras\.json"):
        import_run(tmp_path)


def test_use_source_links_textures_or_attributes(run_folder):
    material = import_run(run_folder, "textures").mesh.active_material
    principled = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    for source, inputs in (("attributes", 3), ("textures", 4), ("attributes", 3)):
        use_source(material, source)
        assert source_of(material) == source
        assert sum(socket.is_linked for socket in principled.inputs) == inputs
    frames = {n.name: n.label for n in material.node_tree.nodes if n.bl_idname == "NodeFrame"}
    assert set(frames) == {"textures", "attributes"} and all("IRGS++" in label for label in frames.values())


def counts() -> dict[str, int]:
    names = ("objects", "meshes", "materials", "images", "worlds", "cameras", "collections", "node_groups")
    return {name: len(getattr(bpy.data, name)) for name in names}


def test_importing_again_replaces(run_folder, tmp_path):
    """A second import creates no duplicates, reads the files again, and keeps the user's changes to objects."""
    shutil.copytree(run_folder, tmp_path / "run")
    first = import_run(tmp_path / "run")
    show_as_photographed(bpy.context.scene, first)
    before, material, camera = counts(), first.mesh.active_material, first.cameras[0]
    first.mesh.name = "mine"
    first.mesh.modifiers.new("soft", "SUBSURF")
    first.root.location.x = 5.0
    write_sphere_run(tmp_path / "run", texture_size=16)
    second = import_run(tmp_path / "run", "attributes")
    assert counts() == before
    assert second.mesh.name == "mine" and "soft" in second.mesh.modifiers and len(second.mesh.material_slots) == 1
    assert second.root.location.x == 5.0
    assert second.mesh.active_material == material and source_of(material) == "attributes"
    assert bpy.context.scene.world == second.world and bpy.context.scene.camera == camera
    sizes = {tuple(n.image.size) for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage"}
    assert sizes == {(16, 16)}


def test_albedo_scale_is_added_and_an_existing_one_stays(run_folder):
    mesh = import_run(run_folder).mesh
    assert mesh["irgspp_albedo_scale"] == 1.0
    mesh["irgspp_albedo_scale"] = 0.5
    assert import_run(run_folder).mesh["irgspp_albedo_scale"] == 0.5


def test_cameras_follow_the_empty_without_lines_to_it(run_folder):
    imported = import_run(run_folder)
    rig = imported.cameras[0].parent
    assert rig.parent == imported.root and rig.hide_viewport and run_of(imported.cameras[0]) == run_folder.resolve()
    bpy.context.view_layer.update()
    moved = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, "Y")
    before = [camera.matrix_world.copy() for camera in imported.cameras]
    imported.root.matrix_world = moved @ imported.root.matrix_world
    bpy.context.view_layer.update()
    for camera, matrix in zip(imported.cameras, before, strict=True):
        assert np.allclose(np.array(camera.matrix_world), np.array(moved @ matrix), atol=1e-5)


def test_cameras_removed_from_the_run_are_removed(run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    import_run(tmp_path / "run")
    records = json.loads((tmp_path / "run" / "cameras.json").read_text())
    (tmp_path / "run" / "cameras.json").write_text(json.dumps(records[1:]))
    bpy.data.objects.new("a person's own", None)
    import_run(tmp_path / "run")
    names = sorted(thing.name for thing in bpy.data.objects)
    assert names == ["a person's own", "run", "run cameras", "run frame", *sorted(f"{r['split']} {r['name']}" for r in records[1:])]
    assert len(bpy.data.cameras) == 2


def test_two_runs_stay_separate(run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "sphere")
    first, second = import_run(run_folder), import_run(tmp_path / "sphere")
    assert first.mesh != second.mesh and first.mesh.active_material != second.mesh.active_material and first.world != second.world
    assert run_of(first.mesh) == run_folder.resolve() and run_of(second.cameras[0]) == (tmp_path / "sphere").resolve()


def test_saved_file_is_complete_when_loaded(run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    show_as_photographed(bpy.context.scene, import_run(tmp_path / "run"))
    before = counts()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert counts() == before
    mesh, light = bpy.data.objects["run"], bpy.context.scene.world.name
    assert source_of(mesh.active_material) == "textures" and mesh.parent.name == "run frame"
    assert all(n.image.has_data or n.image.packed_file for n in mesh.active_material.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage")
    again = import_run(tmp_path / "run")  # its datablocks are recognised and reused
    assert again.mesh == mesh and counts() == before and bpy.context.scene.world.name == light


def test_light_turns_with_the_placement(run_folder):
    imported = import_run(run_folder, placement=Placement("Y_UP", 2.0, False))
    mapping = next(n for n in imported.world.node_tree.nodes if n.bl_idname == "ShaderNodeMapping")
    turned = Euler(mapping.inputs["Rotation"].default_value).to_matrix()
    assert np.allclose(turned @ imported.root.matrix_world.to_quaternion().to_matrix(), np.eye(3), atol=1e-6)


def test_undo_reverts_both_imports(run_folder):
    bpy.ops.ed.undo_push(message="empty")
    first = counts()
    import_run(run_folder)
    bpy.ops.ed.undo_push(message="import")
    second = counts()
    import_run(run_folder, "attributes")
    bpy.ops.ed.undo_push(message="again")
    bpy.ops.ed.undo()
    assert counts() == second and source_of(bpy.data.objects["sphere"].active_material) == "textures"
    bpy.ops.ed.undo()
    assert counts() == first
