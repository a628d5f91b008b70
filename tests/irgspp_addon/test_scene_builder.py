# SPDX-License-Identifier: GPL-3.0-or-later
"""A run becomes an ordinary object whose materials Cycles sees with the right values."""

import shutil

import bpy
import numpy as np
import pytest
import sphere_run
from blender_side import write_sphere_run
from cycles_layers import glowing_inputs
from irgspp.core.errors import InputError
from irgspp.core.scene.cameras import load_cameras
from irgspp.irgspp_addon.ply import read_ply
from irgspp.irgspp_addon.scene_builder import import_run, show_as_photographed


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_homefile(use_empty=True)


def test_ply_reader_agrees_with_what_the_engine_wrote(run_folder):
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
    expected = sphere_run.materials(place.reshape(-1, 3))
    for name, key, size, values in [("albedo", "color", 4, expected[0]), ("roughness", "value", 1, expected[1])]:
        stored = np.empty(size * len(mesh.vertices), np.float32)
        mesh.attributes[name].data.foreach_get(key, stored)
        assert np.allclose(stored.reshape(len(values), -1)[:, :3].reshape(values.shape), values, atol=1e-6)


@pytest.mark.parametrize("source", ["textures", "attributes"])
def test_cycles_reads_the_materials_values(run_folder, tmp_path, source):
    imported = import_run(run_folder, source)
    scene = bpy.context.scene
    show_as_photographed(scene, imported)
    layers = glowing_inputs(scene, imported.mesh.active_material, tmp_path)
    camera = load_cameras(run_folder / "cameras.json")[0].camera
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
    """Where rays (H, W, 3) first meet the unit sphere (H, W, 3), and whether they do (H, W)."""
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
    for name in ("mesh.ply", "environment.exr", "cameras.json"):
        (tmp_path / name).write_bytes((run_folder / name).read_bytes())
    with pytest.raises(InputError, match=r"albedo\.png"):
        import_run(tmp_path, "textures")
    assert not bpy.data.objects  # nothing half-made stays behind
    assert import_run(tmp_path, "attributes").mesh.active_material.name.endswith("attributes")


def test_folder_that_is_no_run(tmp_path):
    with pytest.raises(InputError, match=r"cameras\.json"):
        import_run(tmp_path)


def test_importing_again_reads_the_files_again(run_folder, tmp_path):
    """A run that was made anew in the same folder must not show the old run's packed textures."""
    shutil.copytree(run_folder, tmp_path / "run")
    first = import_run(tmp_path / "run")
    write_sphere_run(tmp_path / "run", texture_size=16)
    second = import_run(tmp_path / "run")
    sizes = [
        {tuple(n.image.size) for n in i.mesh.active_material.node_tree.nodes if n.bl_idname == "ShaderNodeTexImage"}
        for i in (first, second)
    ]
    assert sizes == [{(128, 128)}, {(16, 16)}]
    assert first.mesh is not second.mesh and first.world is not second.world
