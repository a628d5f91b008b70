# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh clean-up, smoothing, decimation and normals on shapes made by trimesh."""

import numpy as np
import trimesh
from irgspp.core.surface import meshing
from irgspp.core.surface.meshing import Triangles


def triangles(body: trimesh.Trimesh) -> Triangles:
    return Triangles(np.array(body.vertices), np.array(body.faces))


def body(mesh: Triangles) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def sphere(subdivisions: int = 4, radius: float = 1.0) -> Triangles:
    return triangles(trimesh.creation.icosphere(subdivisions, radius))


def joined(*meshes: Triangles) -> Triangles:
    return triangles(trimesh.util.concatenate([body(m) for m in meshes]))


def degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles between unit vectors (..., 3)."""
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


def test_cleaned_removes_degenerate_repeated_and_unused():
    good = sphere(1)
    dirty = Triangles(np.concatenate([good.vertices, [[9, 9, 9]]]), np.concatenate([good.faces, good.faces[:3], [[0, 0, 1], [2, 3, 2]]]))
    clean = meshing.cleaned(dirty)
    np.testing.assert_array_equal(clean.faces, good.faces)
    np.testing.assert_array_equal(clean.vertices, good.vertices)


def test_cleaned_removes_both_sides_of_a_fin():
    good = sphere(1)
    a, b, _ = good.faces[0]
    tip = len(good.vertices)
    fin = Triangles(np.concatenate([good.vertices, [[2, 2, 2]]]), np.concatenate([good.faces, [[a, b, tip], [b, a, tip]]]))
    clean = meshing.cleaned(fin)
    np.testing.assert_array_equal(clean.faces, good.faces)
    assert body(clean).is_watertight


def test_main_components_drop_crumbs_and_hollows():
    main, crumb, second = sphere(3), sphere(1, 0.05), sphere(2, 0.6)
    crumb.vertices[:] += 3
    second.vertices[:] -= 3
    hollow = Triangles(0.5 * main.vertices, main.faces[:, ::-1])
    kept = meshing.main_components(joined(hollow, crumb, main, second), 0.03)
    assert len(kept.faces) == len(main.faces) + len(second.faces)
    assert body(kept).volume > 0


def test_smoothing_removes_noise_and_keeps_the_volume():
    clean = sphere(5)
    noise = 0.01 * np.random.default_rng(0).normal(size=len(clean.vertices))
    rough = Triangles(clean.vertices * (1 + noise[:, None]), clean.faces)
    smooth = meshing.smoothed(rough, 10)
    deviation = np.abs(np.linalg.norm(smooth.vertices, axis=-1) - 1)
    assert deviation.mean() < 0.4 * np.abs(noise).mean()
    assert abs(body(smooth).volume / body(clean).volume - 1) < 0.005


def test_smoothing_leaves_a_flat_border_where_it_is():
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0))
    grid = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1), process=False)
    quads = (np.arange(7)[:, None] * 8 + np.arange(7)).ravel()
    faces = np.concatenate([np.stack([quads, quads + 1, quads + 9], -1), np.stack([quads, quads + 9, quads + 8], -1)])
    smooth = meshing.smoothed(Triangles(np.array(grid.vertices), faces), 1)
    side = (x.ravel() == 0) & (y.ravel() > 2) & (y.ravel() < 5)
    np.testing.assert_allclose(smooth.vertices[side, 0], 0, atol=1e-12)


def test_decimation_meets_the_budget_and_stays_closed():
    smaller = meshing.cleaned(meshing.decimated(sphere(5), 2000))
    assert 1800 <= len(smaller.faces) <= 2000
    assert body(smaller).is_watertight
    assert abs(body(smaller).volume / (4 / 3 * np.pi) - 1) < 0.01
    assert meshing.decimated(sphere(2), 10_000).faces is not None
    assert len(meshing.decimated(sphere(2), 10_000).faces) == len(sphere(2).faces)


def test_vertex_normals_of_a_sphere_point_outwards():
    mesh = sphere(4)
    for averages in (0, 3):
        assert degrees(meshing.vertex_normals(mesh, averages), mesh.vertices).mean() < 0.3


def test_a_decimated_mesh_keeps_the_normals_of_the_fine_one():
    fine = sphere(5)
    coarse = meshing.decimated(fine, 3000)
    radial = coarse.vertices / np.linalg.norm(coarse.vertices, axis=-1, keepdims=True)
    carried = meshing.carried_normals(fine, meshing.vertex_normals(fine), coarse)
    assert degrees(carried, radial).mean() < 0.2 < degrees(meshing.vertex_normals(coarse), radial).mean()


def test_vertex_normals_of_a_box_do_not_depend_on_its_triangulation():
    box = triangles(trimesh.creation.box())
    np.testing.assert_allclose(np.abs(meshing.vertex_normals(box)), 1 / np.sqrt(3), atol=1e-12)


def test_normals_average_noise_away():
    clean = sphere(5)
    noise = 0.002 * np.random.default_rng(0).normal(size=len(clean.vertices))
    rough = Triangles(clean.vertices * (1 + noise[:, None]), clean.faces)
    error = [np.arccos(np.clip((meshing.vertex_normals(rough, n) * clean.vertices).sum(-1), -1, 1)).mean() for n in (0, 3)]
    assert error[1] < 0.5 * error[0]
