# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges, components, fans, orientation and border loops of small meshes that are known by heart."""

import numpy as np
import trimesh
from irgspp.core.surface import topology

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def test_edges_of_a_tetrahedron():
    edges = topology.edges_of(TETRAHEDRON)
    assert len(edges.vertices) == 6 and (edges.faces == 2).all()
    assert not edges.border.any() and not edges.non_manifold.any()
    sides, opposite = edges.pairs()
    assert len(sides) == 6 and opposite.all()
    assert (edges.of_side[sides[:, 0]] == edges.of_side[sides[:, 1]]).all()


def test_neighbours_share_an_edge():
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    expected = np.array([[0, 1, 1, 0, 0], [1, 0, 1, 1, 0], [1, 1, 0, 1, 0], [0, 1, 1, 0, 0], [0, 0, 0, 0, 0]])
    np.testing.assert_array_equal(topology.adjacency(faces, 5).toarray(), expected)
    values = np.array([1.0, 2.0, 6.0, 9.0, 7.0])
    np.testing.assert_allclose(topology.neighbour_average(faces, 5) @ values, [3, 4.5, 4.5, 17 / 3, 7])
    np.testing.assert_allclose(topology.neighbour_average(faces, 5, own=False) @ values, [4, 16 / 3, 4, 4, 0])


def test_a_face_less_leaves_a_loop_and_two_leave_two():
    body = trimesh.creation.icosphere(2)
    faces = np.delete(np.array(body.faces), [0], axis=0)
    assert topology.border_loops(topology.edges_of(faces))[1] == 1
    far = np.argmax(np.linalg.norm(body.triangles_center - body.triangles_center[0], axis=-1))
    label, count = topology.border_loops(topology.edges_of(np.delete(np.array(body.faces), [0, far], axis=0)))
    assert count == 2 and sorted(np.bincount(label)) == [3, 3]
    assert topology.border_loops(topology.edges_of(TETRAHEDRON))[1] == 0


def test_components_are_connected_across_edges_alone():
    touching = np.concatenate([TETRAHEDRON, np.array([3, 4, 5, 6])[TETRAHEDRON]])  # at vertex 3
    edges = topology.edges_of(touching)
    assert topology.face_components(touching, edges).tolist() == [0] * 4 + [1] * 4
    assert topology.non_manifold_vertices(touching, edges).tolist() == [3]
    assert not len(topology.non_manifold_vertices(TETRAHEDRON, topology.edges_of(TETRAHEDRON)))


def test_the_smaller_side_counts_as_flipped():
    faces = TETRAHEDRON.copy()
    faces[1] = faces[1, ::-1]
    edges, area = topology.edges_of(faces), np.ones(4)
    assert topology.flipped_faces(faces, edges, area).tolist() == [False, True, False, False]
    assert topology.flipped_faces(faces, edges, np.array([1, 9, 1, 1.0])).tolist() == [True, False, True, True]
    assert not topology.flipped_faces(TETRAHEDRON, topology.edges_of(TETRAHEDRON), area).any()


def test_a_moebius_strip_can_not_be_wound():
    strip = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5], [4, 5, 1], [1, 5, 0]])
    assert topology.flipped_faces(strip, topology.edges_of(strip), np.ones(6)).all()
