# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that lie over others in UV space become charts of their own."""

import numpy as np
import trimesh
from irgspp.core.surface.meshing import Triangles
from irgspp.core.surface.unwrap import PADDING, unwrap
from irgspp.core.surface.uv_overlap import covering_faces, without_overlap

TEXTURE = 256


def unwrapped():
    body = trimesh.creation.icosphere(3)
    mesh = Triangles(np.array(body.vertices), np.array(body.faces))
    return mesh, *unwrap(mesh, TEXTURE)


def mend(mesh, source, faces, uvs):
    return without_overlap(mesh, source, faces, uvs, TEXTURE, PADDING)


def test_layout_without_overlap_stays():
    mesh, source, faces, uvs = unwrapped()
    assert covering_faces(uvs, faces).max() == 1
    assert mend(mesh, source, faces, uvs)[2] is uvs


def test_faces_that_overlap_or_have_no_area_are_moved_and_the_rest_stays():
    mesh, source, faces, uvs = unwrapped()
    count, old = len(faces), uvs[faces]
    uvs = np.concatenate([uvs, old[4], old[300], np.repeat(old[9, :1], 3, 0)]).astype(np.float32)
    source = np.concatenate([source, source[faces[700]], source[faces[701]], source[faces[702]]])
    faces = faces.copy()
    faces[700:703] = np.arange(len(uvs) - 9, len(uvs)).reshape(3, 3)
    assert covering_faces(uvs, faces).max() == 2
    new_source, new_faces, new_uvs = mend(mesh, source, faces, uvs)
    assert covering_faces(new_uvs, new_faces).max() == 1 and len(new_faces) == count
    np.testing.assert_array_equal(new_source[new_faces], source[faces])  # every face is where it was in space
    changed = np.nonzero((new_uvs[new_faces] != uvs[faces]).any((1, 2)))[0]
    np.testing.assert_array_equal(changed, [700, 701, 702])
    assert new_uvs.min() >= 0 and new_uvs.max() <= 1 and len(np.unique(new_faces)) == len(new_uvs)


def test_moved_face_keeps_its_density_and_side_and_distance():
    mesh, source, faces, uvs = unwrapped()
    corner = uvs[faces]
    uvs = np.concatenate([uvs, corner[4]]).astype(np.float32)
    source = np.concatenate([source, source[faces[700]]])
    faces = faces.copy()
    faces[700] = np.arange(len(uvs) - 3, len(uvs))
    _, new_faces, new_uvs = mend(mesh, source, faces, uvs)

    def area(triangle):
        (a, b), (c, d) = triangle[1] - triangle[0], triangle[2] - triangle[0]
        return (a * d - b * c) / 2

    assert abs(area(new_uvs[new_faces[700]]) / area(corner[700]) - 1) < 0.3  # positive: not mirrored
    others = np.delete(new_uvs[new_faces], 700, 0).reshape(-1, 2)
    apart = np.linalg.norm(others[:, None] - new_uvs[new_faces[700]], axis=-1).min()
    assert apart * TEXTURE >= PADDING - 1


def test_no_room_shrinks_the_face():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    mesh = Triangles(square, np.array([[0, 1, 2], [0, 2, 3], [0, 1, 3]]))
    full = 0.01 + 0.98 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    source, faces, uvs = mend(mesh, np.arange(4), mesh.faces.astype(np.int32), full)
    assert len(faces) == 3 and uvs.min() >= 0 and uvs.max() <= 1 and len(source) == 7
    assert np.ptp(uvs[faces[2]], axis=0).max() < 0.02
