# SPDX-License-Identifier: GPL-3.0-or-later
"""The GLB as trimesh and Blender read it."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from gltf_validator import gltf_problems
from irgspp.core.scene.glb import save_glb
from irgspp.core.surface.bake import tangents

BLENDER = """
import json, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
(body,) = [o for o in bpy.data.objects if o.type == "MESH"]
nodes = body.data.materials[0].node_tree.nodes
shader = next(n for n in nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
spaces = {i.name: i.colorspace_settings.name for i in bpy.data.images if i.users}
loop = body.data.loops[0]
print("RESULT" + json.dumps({
    "vertices": [list(body.matrix_world @ v.co) for v in body.data.vertices],
    "loop_vertex": [l.vertex_index for l in body.data.loops],
    "uv": [list(d.uv) for d in body.data.uv_layers[0].data],
    "linked": {n: shader.inputs[n].is_linked for n in ("Base Color", "Roughness", "Metallic", "Normal")},
    "spaces": sorted(spaces.values()),
}))
"""


def only_geometry(path) -> trimesh.Trimesh:
    (body,) = trimesh.load(path, process=False).geometry.values()
    return body


def test_khronos_validator_finds_nothing(mesh, tmp_path):
    mesh = replace(mesh, vertices=2 * mesh.vertices)  # else positions and normals are equal, which trimesh writes once
    save_glb(mesh, tmp_path / "asset.glb", tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces))
    assert gltf_problems(tmp_path / "asset.glb") == []


def test_trimesh_reads_it_with_y_up(mesh, tmp_path):
    save_glb(mesh, tmp_path / "asset.glb")
    body = only_geometry(tmp_path / "asset.glb")
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(body.vertices, np.stack([x, z, -y], -1), atol=1e-6)
    np.testing.assert_allclose(body.vertex_normals, np.stack([x, z, -y], -1), atol=1e-5)
    np.testing.assert_array_equal(body.faces, mesh.faces)
    np.testing.assert_allclose(body.visual.uv, mesh.uvs, atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == ["asset.glb"]


def test_confidence_is_one_attribute(mesh, tmp_path):
    """Blender's importer mixes up several custom attributes, and then fails at random."""
    known = np.linspace(0, 1, len(mesh.vertices), dtype=np.float32)
    materials = np.stack([known, 1 - known, known**2], -1)
    for one, three, true in ((known, None, known[:, None]), (None, materials, materials), (known, materials, np.c_[known, materials])):
        save_glb(replace(mesh, confidence=one, material_confidence=three), tmp_path / "asset.glb")
        read = only_geometry(tmp_path / "asset.glb").vertex_attributes
        assert list(read) == ["_CONFIDENCE"]
        np.testing.assert_array_equal(np.asarray(read["_CONFIDENCE"]).reshape(true.shape), true)


def test_textures_are_in_their_slots(mesh, tmp_path):
    save_glb(mesh, tmp_path / "asset.glb")
    material = only_geometry(tmp_path / "asset.glb").visual.material
    np.testing.assert_array_equal(np.asarray(material.baseColorTexture.convert("RGB")), mesh.textures["albedo"])
    np.testing.assert_array_equal(np.asarray(material.normalTexture.convert("RGB")), mesh.textures["normal"])
    packed = np.asarray(material.metallicRoughnessTexture.convert("RGB"))
    np.testing.assert_array_equal(packed[..., 1], mesh.textures["roughness"])
    np.testing.assert_array_equal(packed[..., 2], mesh.textures["metallic"])
    assert material.roughnessFactor == material.metallicFactor == 1


@pytest.mark.parametrize("textured", [True, False])
def test_the_material_has_the_object_s_name(mesh, tmp_path, textured):
    save_glb(mesh if textured else replace(mesh, textures={}), tmp_path / "asset.glb", name="chair")
    assert only_geometry(tmp_path / "asset.glb").visual.material.name == "chair"


def test_without_textures_the_vertices_carry_linear_colour(mesh, tmp_path):
    save_glb(replace(mesh, textures={}), tmp_path / "asset.glb")
    body = only_geometry(tmp_path / "asset.glb")
    colour = body.visual.vertex_attributes["color"][:, :3]
    np.testing.assert_allclose(colour / 255.0, mesh.albedo, atol=0.003)
    assert body.visual.material.roughnessFactor == pytest.approx(mesh.roughness.mean(), abs=1e-3)


def test_blender_imports_it(mesh, tmp_path):
    pytest.importorskip("bpy")
    save_glb(mesh, tmp_path / "asset.glb")
    run = subprocess.run([sys.executable, "-c", BLENDER, str(tmp_path / "asset.glb")], capture_output=True, text=True, timeout=300)
    line = next((line for line in run.stdout.splitlines() if line.startswith("RESULT")), None)
    assert line, run.stdout + run.stderr
    result = json.loads(line.removeprefix("RESULT"))
    vertices, uv = np.array(result["vertices"]), np.array(result["uv"])
    order = [int(np.abs(mesh.vertices - v).sum(-1).argmin()) for v in vertices]
    np.testing.assert_allclose(vertices, mesh.vertices[order], atol=1e-5)  # back in +Z up
    np.testing.assert_allclose(uv, mesh.uvs[np.array(order)[result["loop_vertex"]]], atol=1e-5)
    assert all(result["linked"].values())
    assert result["spaces"] == ["Non-Color", "Non-Color", "sRGB"]
