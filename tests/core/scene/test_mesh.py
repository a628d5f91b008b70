# SPDX-License-Identifier: GPL-3.0-or-later
"""Quads of a mesh: pairs of triangles that stay one polygon as long as they share their diagonal."""

import numpy as np
from irgspp.core.scene.mesh import joined_quads

FACES = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4], [5, 6, 7], [5, 7, 8]])
QUADS = np.array([True, False, False, True, False])


def test_pairs_with_a_common_diagonal_are_quads():
    assert np.array_equal(joined_quads(FACES, QUADS), QUADS)


def test_a_quad_cut_along_its_diagonal_is_two_triangles():
    cut = FACES.copy()
    cut[1, 1] = 9  # the copy of a vertex on the other side of a UV seam
    assert joined_quads(cut, QUADS).tolist() == [False, False, False, True, False]
    cut[4, 0] = 10
    assert joined_quads(cut, QUADS) is None


def test_a_quad_whose_second_half_is_gone_is_no_quad():
    assert joined_quads(FACES[[0, 3, 4]], QUADS[[0, 3, 4]]).tolist() == [False, True, False]
    assert joined_quads(FACES[:4], QUADS[:4]).tolist() == [True, False, False, False]
    assert joined_quads(FACES, np.zeros(5, bool)) is None and joined_quads(FACES, None) is None
