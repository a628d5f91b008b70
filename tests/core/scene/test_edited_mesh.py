# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes edited in modelling programs: polygons, unconnected faces, names of UVs, and broken files."""

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.scene.edited_mesh import load_edited_mesh
from plyfile import PlyData, PlyElement

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], float)


def write(path, points, polygons, text=False, **columns):
    names = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], **columns}
    vertex = np.empty(len(points), [(name, "f4") for name in names])
    for name, values in names.items():
        vertex[name] = values
    face = np.empty(len(polygons), [("vertex_indices", object)])
    face["vertex_indices"] = [np.array(p, np.int32) for p in polygons]
    elements = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face", len_types={"vertex_indices": "u1"})]
    PlyData(elements, text=text).write(str(path))
    return path


def area(mesh):
    corner = mesh.vertices[mesh.faces]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=-1).sum() / 2


@pytest.mark.parametrize("text", [False, True])
def test_polygons_become_triangles_of_the_same_area_and_side(tmp_path, text):
    mesh = load_edited_mesh(write(tmp_path / "a.ply", SQUARE, [[0, 1, 2, 3], [1, 4, 2]], text))
    assert len(mesh.faces) == 3 and len(mesh.vertices) == 5 and area(mesh) == pytest.approx(1.5)
    corner = mesh.vertices[mesh.faces]
    assert (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0).all()
    assert mesh.uvs is None and mesh.normals is None


def test_quads_are_known_from_polygons_or_from_marks(tmp_path):
    polygons = load_edited_mesh(write(tmp_path / "a.ply", SQUARE, [[1, 4, 2], [0, 1, 2, 3]]))
    assert polygons.quads.tolist() == [False, True, False]
    assert load_edited_mesh(write(tmp_path / "b.ply", SQUARE, [[0, 1, 2], [0, 2, 3]])).quads is None
    assert load_edited_mesh(write(tmp_path / "c.ply", SQUARE, [[0, 1, 4, 2, 3]])).quads is None  # a pentagon
    mesh = load_mesh(tmp_path / "d.ply", np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]]), np.array([1, 0, 0]))
    assert mesh.quads.tolist() == [True, False, False]


def load_mesh(path, faces, marks):
    """Write triangles of SQUARE with marks of quads, and read them."""
    vertex = np.array([tuple(point) for point in SQUARE], [(name, "f4") for name in "xyz"])
    face = np.empty(len(faces), [("vertex_indices", "i4", (3,)), ("quad", "u1")])
    face["vertex_indices"], face["quad"] = faces, marks
    PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")]).write(str(path))
    return load_edited_mesh(path)


def test_equal_vertices_are_merged_but_not_across_seams(tmp_path):
    torn = SQUARE[[0, 1, 2, 0, 2, 3]]
    same = {"s": torn[:, 0], "t": torn[:, 1]}
    assert len(load_edited_mesh(write(tmp_path / "a.ply", torn, [[0, 1, 2], [3, 4, 5]], **same)).vertices) == 4
    seam = {"u": np.array([0, 0.4, 0.4, 0.6, 1, 1]), "v": torn[:, 1]}
    mesh = load_edited_mesh(write(tmp_path / "b.ply", torn, [[0, 1, 2], [3, 4, 5]], **seam))
    assert len(mesh.vertices) == 6
    assert mesh.uvs is not None
    assert {(round(u, 3), v) for u, v in mesh.uvs.tolist()} == {(0, 0), (0.4, 0), (0.4, 1), (0.6, 0), (1, 1)}


def test_normals_come_with_length_one_or_not_at_all(tmp_path):
    up = {"nx": 0 * SQUARE[:, 0], "ny": 0 * SQUARE[:, 0], "nz": 3 + 0 * SQUARE[:, 0]}
    mesh = load_edited_mesh(write(tmp_path / "a.ply", SQUARE, [[0, 1, 2, 3]], **up))
    assert mesh.normals is not None and np.array_equal(mesh.normals, np.tile([0, 0, 1], (4, 1)))
    up["nz"] = 0 * SQUARE[:, 0]
    assert load_edited_mesh(write(tmp_path / "a.ply", SQUARE, [[0, 1, 2, 3]], **up)).normals is None


def test_bad_files_are_reported_in_one_line(tmp_path):
    def refused(words):
        with pytest.raises(InputError, match=words) as caught:
            load_edited_mesh(tmp_path / "a.ply")
        assert "a.ply" in str(caught.value) and "\n" not in str(caught.value)

    refused("no such file")
    (tmp_path / "a.ply").write_bytes(b"nonsense")
    refused("not a readable PLY")
    data = write(tmp_path / "a.ply", SQUARE, [[0, 1, 2]]).read_bytes()
    (tmp_path / "a.ply").write_bytes(data[:-6])
    refused("not a readable PLY")
    write(tmp_path / "a.ply", SQUARE, [[0, 1, 7]])
    refused("beyond the 5")
    write(tmp_path / "a.ply", SQUARE, [[0, 1, 1]])
    refused("has no faces")
    write(tmp_path / "a.ply", np.array([[np.nan, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]])
    refused("not finite")
    write(tmp_path / "a.ply", SQUARE, [[0, 1, 2]], s=SQUARE[:, 0] * 3, t=SQUARE[:, 1])
    refused("outside of 0..4; unwrap it into one square, or into UDIM tiles up to 1034")


@pytest.mark.parametrize(("largest", "tiles"), [(0.2, 1), (1.0, 1), (1.00001, 1), (1.2, 2), (2.0, 2), (4.0, 4)])
def test_uvs_beyond_one_lie_in_tiles(tmp_path, largest, tiles):
    u = SQUARE[:, 0] / 2 * largest
    mesh = load_edited_mesh(write(tmp_path / "a.ply", SQUARE, [[0, 1, 2, 3], [1, 4, 2]], s=u, t=SQUARE[:, 1] / 8))
    assert mesh.uvs is not None and mesh.tiles == tiles
    assert mesh.uvs[:, 0].max() == pytest.approx(min(largest / tiles, 1), abs=1e-6) and mesh.uvs[:, 1].max() == pytest.approx(1 / 8 / tiles)
