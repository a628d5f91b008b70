# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair of meshes with holes, sheets that touch, and folds, made on purpose."""

import numpy as np
import pytest
import trimesh
from irgspp.core.surface import meshing, repair, topology
from irgspp.core.surface.meshing import Triangles


def sphere(subdivisions: int = 3) -> Triangles:
    body = trimesh.creation.icosphere(subdivisions)
    return Triangles(np.array(body.vertices), np.array(body.faces))


def body(mesh: Triangles) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def counts(mesh: Triangles) -> tuple[int, int, int]:
    """Return the numbers of edges with several faces, vertices where parts only touch, and border edges."""
    edges = topology.edges_of(mesh.faces)
    return int(edges.non_manifold.sum()), len(topology.non_manifold_vertices(mesh.faces, edges)), int(edges.border.sum())


def blocks(*cells: tuple[int, int, int]) -> Triangles:
    """Return the border of a solid of unit cells."""
    filled = np.zeros(np.max(cells, axis=0) + 3, bool)
    filled[tuple(np.transpose(cells) + 1)] = True
    unit, quads = np.eye(3, dtype=int), []
    for cell in np.argwhere(filled):
        for axis in range(3):
            for side in (0, 1):
                if filled[tuple(cell + (2 * side - 1) * unit[axis])]:
                    continue
                corner, u, v = cell + side * unit[axis], unit[(axis + 1) % 3], unit[(axis + 2) % 3]
                square = [corner, corner + u, corner + u + v, corner + v]
                quads.append(square if side else square[::-1])
    points, index = np.unique(np.reshape(quads, (-1, 3)), axis=0, return_inverse=True)
    index = index.reshape(-1, 4)
    return Triangles(points.astype(float), np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]]))


def test_small_holes_are_filled_and_ends_stay_open():
    ball = sphere()
    centre = ball.vertices[ball.faces].mean(1)
    pierced = Triangles(ball.vertices, ball.faces[np.linalg.norm(centre - [0, 0, 1], axis=-1) > 0.3])
    whole = repair.fill_holes(pierced, 3.0)
    assert counts(pierced)[2] > 8 and counts(whole) == (0, 0, 0)
    assert body(whole).is_winding_consistent and abs(body(whole).volume / body(ball).volume - 1) < 0.02
    half = Triangles(ball.vertices, ball.faces[centre[:, 2] > 0])
    assert repair.fill_holes(half, 3.0).faces.shape == half.faces.shape
    assert repair.fill_holes(ball, 3.0) is ball


def test_two_holes_get_two_lids():
    ball = sphere()
    centre = ball.vertices[ball.faces].mean(1)
    pierced = Triangles(ball.vertices, ball.faces[np.abs(centre[:, 2]) < 0.95])
    whole = repair.fill_holes(pierced, 3.0)
    assert len(whole.vertices) == len(ball.vertices) + 2 and body(whole).is_watertight


@pytest.mark.parametrize("corners", [((0, 0, 0), (1, 1, 0)), ((0, 0, 0), (1, 1, 1)), ((0, 0, 0), (1, 1, 0), (2, 2, 0), (1, 1, 1))])
def test_solids_that_touch_at_edges_or_points_are_parted(corners):
    touching = blocks(*corners)
    assert sum(counts(touching)[:2]) > 0
    parted = repair.make_manifold(touching)
    assert counts(parted) == (0, 0, 0) and len(np.unique(parted.vertices, axis=0)) == len(parted.vertices)
    assert body(parted).is_watertight and body(parted).is_winding_consistent
    assert abs(body(parted).volume / len(corners) - 1) < 0.05
    assert repair.make_manifold(parted) is parted


def test_sheets_that_hang_together_at_both_ends_are_parted_in_the_middle():
    middle = {(0, 1, 1), (1, 0, 1)}  # cells left out: one edge of four faces, whose ends lie inside the solid's surface
    solid = blocks(*(cell for cell in np.ndindex(2, 2, 3) if cell not in middle))
    assert counts(solid)[0] == 1
    parted = repair.make_manifold(solid)
    assert counts(parted) == (0, 0, 0) and body(parted).is_winding_consistent
    assert abs(body(parted).volume / 10 - 1) < 0.02


def folds(mesh: Triangles) -> int:
    return int(repair.folded_faces(mesh, meshing.vertex_normals(mesh, repair.NORMAL_AVERAGES)).sum())


def test_folded_face_is_unfolded_and_the_rest_stays():
    ball = sphere()
    a, b, c = ball.faces[100]
    tip = (ball.vertices[b] + ball.vertices[c]) / 2 * 1.3 - 0.3 * ball.vertices[a]  # beyond the edge from b to c
    vertices, p = np.concatenate([ball.vertices, tip[None]]), len(ball.vertices)
    folded = Triangles(vertices, np.concatenate([np.delete(ball.faces, 100, 0), [[a, b, p], [b, c, p], [c, a, p]]]))
    assert folds(folded) == 1
    smooth = repair.unfold(folded)
    assert folds(smooth) == 0
    moved = np.linalg.norm(smooth.vertices - vertices, axis=-1) > 0
    assert 1 <= moved.sum() <= 4 and np.abs(np.linalg.norm(smooth.vertices, axis=-1) - 1).max() < 0.1
    assert repair.unfold(ball) is ball


def test_unfolding_near_the_folds_is_unfolding_of_the_whole_mesh(monkeypatch):
    ball = trimesh.creation.icosphere(4)
    noise = np.random.default_rng(0).normal(size=ball.vertices.shape)
    noisy = Triangles(np.asarray(ball.vertices) + np.where(ball.vertices[:, :1] > 0.8, 0.04, 0) * noise, np.asarray(ball.faces))
    assert folds(noisy) > 5
    near = repair.unfold(noisy)
    monkeypatch.setattr(repair, "AFFECTED_RINGS", 200)
    monkeypatch.setattr(repair, "SUPPORT_RINGS", 200)
    np.testing.assert_array_equal(near.vertices, repair.unfold(noisy).vertices)


def folded_sphere() -> Triangles:
    """Return a sphere with one face divided at a point that lies behind the opposite edge, so that the part there is folded."""
    ball = sphere()
    a, b, c = ball.faces[100]
    tip = (ball.vertices[b] + ball.vertices[c]) / 2 * 1.3 - 0.3 * ball.vertices[a]
    vertices, p = np.concatenate([ball.vertices, tip[None]]), len(ball.vertices)
    return Triangles(vertices, np.concatenate([np.delete(ball.faces, 100, 0), [[a, b, p], [b, c, p], [c, a, p]]]))


def test_fold_that_stays_is_collapsed(monkeypatch):
    monkeypatch.setattr(repair, "MAX_UNFOLDING_STEPS", 0)
    folded = folded_sphere()
    whole = repair.remove_folds(folded, 10.0)
    assert folds(whole) == 0 and counts(whole) == (0, 0, 0)
    assert len(folded.faces) - 6 <= len(whole.faces) < len(folded.faces) and abs(body(whole).volume / body(sphere()).volume - 1) < 0.01


def test_hole_that_a_division_leaves_is_filled(monkeypatch):
    monkeypatch.setattr(repair, "MAX_UNFOLDING_STEPS", 0)
    divide = repair.make_manifold
    monkeypatch.setattr(repair, "make_manifold", lambda mesh: divide(Triangles(mesh.vertices, mesh.faces[1:])))
    assert counts(repair.remove_folds(folded_sphere(), 0.0)) == (0, 0, 3)  # no border is short enough to be a hole
    whole = repair.remove_folds(folded_sphere(), 10.0)
    assert folds(whole) == 0 and counts(whole) == (0, 0, 0)


def test_normals_that_a_face_turns_away_from_are_replaced():
    ball = sphere()
    normals = meshing.vertex_normals(ball)
    wrong = normals.copy()
    wrong[ball.faces[7]] *= -1
    mended = repair.facing_normals(ball, wrong)
    np.testing.assert_allclose(mended, normals, atol=1e-12)
    tilted = meshing.unit(normals + 0.1)
    np.testing.assert_array_equal(repair.facing_normals(ball, tilted), tilted)
