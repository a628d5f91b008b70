# SPDX-License-Identifier: GPL-3.0-or-later
"""An edited mesh as triangles for the engine, with the halves of its quads marked."""

import bpy
import numpy as np
import pytest
from irgspp.irgspp_addon.importer.edited_mesh import write_mesh
from irgspp.irgspp_addon.importer.ply import read_ply

POINTS = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [4, 0, 0], [4, 2, 0], [3, 0.5, 0], [6, 1, 0], [5, 3, 0], [3, 3, 0]], float)
# A quad, a concave quad, whose diagonal must lie inside, a triangle and a pentagon.
POLYGONS = [(0, 1, 2, 3), (1, 6, 4, 2), (4, 5, 2), (5, 7, 8, 9, 2)]


def halves(path):
    """Return the corners (F, 3, 3) of the triangles and their marks."""
    elements = read_ply(path)
    place = np.stack([elements["vertex"][name] for name in "xyz"], -1)
    return place[elements["face"]["vertex_indices"]], elements["face"]["quad"].astype(bool)


@pytest.mark.parametrize("mirrored", [False, True])
def test_quads_are_marked_and_every_triangle_lies_in_its_polygon(tmp_path, mirrored):
    mesh = bpy.data.meshes.new("edited")
    mesh.from_pydata(POINTS.tolist(), [], POLYGONS)
    write_mesh(tmp_path / "a.ply", mesh, np.diag([-1.0 if mirrored else 1.0, 1, 1, 1]), "edited")
    corners, quads = halves(tmp_path / "a.ply")
    assert quads.tolist() == [True, False, True, False, False, False, False, False]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (facing > 0).all()
    for first, polygon in ((0, POLYGONS[0]), (2, POLYGONS[1])):
        (a, b, c), (d, e, f) = corners[first], corners[first + 1]
        assert (a == d).all() and (c == e).all()
        ring = np.stack([a, b, c, f]) * ([-1, 1, 1] if mirrored else 1)
        expected = POINTS[list(polygon)]
        turns = [np.roll(expected[:: -1 if mirrored else 1], k, axis=0) for k in range(4)]
        assert any(np.allclose(ring, turn) for turn in turns)
