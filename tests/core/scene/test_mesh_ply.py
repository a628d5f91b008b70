# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh as PLY: exact round trip, and readable by other programs."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from numpy.lib.recfunctions import repack_fields
from plyfile import PlyData, PlyElement

FIELDS = ("vertices", "normals", "uvs", "faces", "albedo", "roughness", "metallic")


def test_round_trip_is_exact(mesh, tmp_path):
    save_mesh_ply(mesh, tmp_path / "mesh.ply")
    loaded = load_mesh_ply(tmp_path / "mesh.ply")
    for field in FIELDS:
        expected, got = getattr(mesh, field), getattr(loaded, field)
        np.testing.assert_array_equal(got, expected)
        assert got.dtype == expected.dtype
    assert loaded.textures == {}
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]  # no temporary file stays


def test_quads_are_kept(mesh, tmp_path):
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], np.int32)
    save_mesh_ply(replace(mesh, faces=faces, quads=np.array([True, False, False])), tmp_path / "mesh.ply")
    assert load_mesh_ply(tmp_path / "mesh.ply").quads.tolist() == [True, False, False]
    assert len(trimesh.load(tmp_path / "mesh.ply", process=False).faces) == 3  # other programs see triangles
    save_mesh_ply(mesh, tmp_path / "mesh.ply")
    assert load_mesh_ply(tmp_path / "mesh.ply").quads is None


def test_confidence_is_kept_where_it_is_known(mesh, tmp_path):
    path, confidence = tmp_path / "mesh.ply", np.linspace(0, 1, len(mesh.vertices), dtype=np.float32)
    materials = np.stack([confidence, 1 - confidence, confidence**2], -1)
    save_mesh_ply(replace(mesh, confidence=confidence, material_confidence=materials), path)
    loaded = load_mesh_ply(path)
    np.testing.assert_array_equal(loaded.confidence, confidence)
    np.testing.assert_array_equal(loaded.material_confidence, materials)
    save_mesh_ply(replace(mesh, confidence=confidence), path)
    assert load_mesh_ply(path).material_confidence is None and load_mesh_ply(path).confidence is not None
    save_mesh_ply(mesh, path)
    assert load_mesh_ply(path).confidence is None


def test_a_loaded_file_can_be_written_again(mesh, tmp_path):
    path = tmp_path / "mesh.ply"
    save_mesh_ply(mesh, path)
    loaded = load_mesh_ply(path)
    save_mesh_ply(loaded, path)
    np.testing.assert_array_equal(load_mesh_ply(path).vertices, mesh.vertices)


def test_ascii_is_read_too(mesh, tmp_path):
    path = tmp_path / "mesh.ply"
    save_mesh_ply(mesh, path)
    ply = PlyData.read(str(path), mmap=False)
    ply.text = True
    ply.write(str(tmp_path / "text.ply"))
    loaded = load_mesh_ply(tmp_path / "text.ply")
    np.testing.assert_array_equal(loaded.faces, mesh.faces)
    np.testing.assert_allclose(loaded.albedo, mesh.albedo, atol=1e-6)


def test_other_viewers_see_shape_and_colour(mesh, tmp_path):
    save_mesh_ply(mesh, tmp_path / "mesh.ply")
    other = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_allclose(other.vertices, mesh.vertices)
    np.testing.assert_array_equal(other.faces, mesh.faces)
    colour = PlyData.read(str(tmp_path / "mesh.ply"))["vertex"]
    linear = decode_srgb(np.stack([colour[c] for c in ("red", "green", "blue")], -1) / 255.0)
    np.testing.assert_allclose(linear, mesh.albedo, atol=0.006)


def rewritten(path, vertex=None, face=None):
    ply = PlyData.read(str(path), mmap=False)
    vertex = ply["vertex"].data if vertex is None else vertex
    elements = [PlyElement.describe(vertex, "vertex")]
    if face is None or len(face):
        elements.append(ply["face"] if face is None else PlyElement.describe(face, "face"))
    PlyData(elements).write(str(path))


def truncate(path):
    path.write_bytes(path.read_bytes()[:-100])


def drop_metallic(path):
    vertex = PlyData.read(str(path), mmap=False)["vertex"].data
    rewritten(path, repack_fields(vertex[[name for name in vertex.dtype.names if name != "metallic"]]))


def spoil_vertex(path):
    vertex = PlyData.read(str(path), mmap=False)["vertex"].data.copy()
    vertex["y"][3] = np.nan
    rewritten(path, vertex)


def spoil_face(path):
    face = np.zeros(1, [("vertex_indices", "i4", (3,))])
    face["vertex_indices"] = 0, 1, 10_000
    rewritten(path, face=face)


def quads(path):
    face = np.zeros(1, [("vertex_indices", "i4", (4,))])
    face["vertex_indices"] = 0, 1, 2, 3
    rewritten(path, face=face)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (truncate, "not a readable PLY"),
        (drop_metallic, "lack metallic"),
        (spoil_vertex, "not finite"),
        (spoil_face, "vertices beyond"),
        (quads, "triangles"),
        (lambda path: rewritten(path, face=[]), "no face element"),
        (lambda path: path.write_bytes(b""), "not a readable PLY"),
        (lambda path: path.write_bytes(b"solid nothing\n"), "not a readable PLY"),
        (lambda path: path.unlink(), "no such file"),
    ],
)
def test_a_broken_file_is_one_clear_line(mesh, tmp_path, damage, reason):
    path = tmp_path / "mesh.ply"
    save_mesh_ply(mesh, path)
    damage(path)
    with pytest.raises(InputError, match=reason) as error:
        load_mesh_ply(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
