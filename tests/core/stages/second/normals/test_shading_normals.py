# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals fitted to shading under a known light: a carved sphere turns its normals, a painted one does not."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.scene.surface import Surface
from irgspp.core.stages.second.normals.shading_normals import (
    MAX_SLOPE_DEVIATION,
    SLOPE_DEVIATION,
    DiffuseShading,
    fit_normals,
    log_irradiance,
    slope_deviation,
)
from irgspp.core.stages.second.normals.surface_gradient import SurfaceGradient, subdivided

RADIUS = 20.0


def sphere(levels: int) -> Surface:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [[x, y, z] if (x + y + z) // 3 % 2 == 1 else [y, x, z] for x in (0, 3) for y in (1, 4) for z in (2, 5)]
    mesh = Surface(axes, axes, np.array(faces), 1.0)
    for _ in range(levels):
        mesh = subdivided(mesh)
        mesh = Surface(mesh.normals, mesh.normals, mesh.faces, 1.0)
    return Surface(RADIUS * mesh.vertices, mesh.normals, mesh.faces, 1.0)


def light(count: int) -> np.ndarray:
    """Return the same light for all vertices: grey ambient, a warm lamp above and a blue one from +X."""
    harmonics = np.zeros((9, 3))
    harmonics[0], harmonics[2], harmonics[3] = 3.0, (0.9, 0.7, 0.5), (-0.3, -0.5, -0.8)
    return np.repeat(harmonics[None], count, 0)


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(1), -1, 1)))


def shaded(normals: np.ndarray, log_albedo: np.ndarray | float) -> DiffuseShading:
    harmonics = light(len(normals))
    noise = 0.005 * np.random.default_rng(0).standard_normal((len(normals), 3))
    return DiffuseShading(log_irradiance(harmonics, normals)[0] + log_albedo + noise, np.full(len(normals), 1e3), harmonics)


def test_faces_of_the_test_sphere_face_outward_and_the_gradient_is_that_of_a_linear_function():
    mesh = sphere(4)
    corner = mesh.vertices[mesh.faces]
    assert (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * corner[:, 0]).sum(1).min() > 0
    operators, along = SurfaceGradient.of(mesh), np.array([0.3, -0.5, 0.8])
    tangent = along - mesh.normals * (mesh.normals @ along)[:, None]
    assert operators.slope(mesh.vertices @ along / operators.length) == pytest.approx(tangent, abs=0.03)
    assert operators.difference @ np.ones(len(mesh.vertices)) == pytest.approx(0)
    assert operators.average @ np.ones(len(mesh.vertices)) == pytest.approx(1)


def test_the_derivative_of_the_irradiance_is_that_of_finite_differences():
    normals = sphere(2).normals
    harmonics = light(len(normals)) + 0.1 * np.random.default_rng(1).standard_normal((len(normals), 9, 3))
    value, slope = log_irradiance(harmonics, normals)
    change = 1e-6 * np.array([0.3, 0.7, -0.2])
    assert log_irradiance(harmonics, normals + change)[0] - value == pytest.approx(slope @ change, abs=1e-10)


def carved(mesh: Surface, height: np.ndarray) -> np.ndarray:
    """Return the normals (V, 3) of a mesh that is displaced by a height (V,) in edges."""
    normals = mesh.normals - SurfaceGradient.of(mesh).slope(height)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_a_carved_sphere_of_one_colour_gets_the_relief_that_its_mesh_lacks():
    mesh = sphere(5)
    x, y, z = mesh.vertices.T / SurfaceGradient.of(mesh).length
    coarse = 1.2 * np.sin(0.3 * x + 1) * np.sin(0.3 * y) * np.cos(0.3 * z)
    truth = carved(mesh, coarse + 0.6 * np.sin(0.6 * x) * np.sin(0.6 * y + 1) * np.cos(0.6 * z))
    found = replace(mesh, normals=carved(mesh, 0.7 * coarse))
    fitted, _ = fit_normals(found, shaded(truth, np.log([0.6, 0.55, 0.5])))
    assert np.array_equal(fitted.vertices, mesh.vertices)
    assert angles(found.normals, truth).mean() > 5
    assert angles(fitted.normals, truth).mean() < 0.6 * angles(found.normals, truth).mean()


def test_grey_paint_of_the_same_pattern_on_a_smooth_sphere_is_no_relief():
    mesh = sphere(5)
    x, y, z = mesh.vertices.T / SurfaceGradient.of(mesh).length
    paint = 0.5 * np.sin(0.6 * x) * np.sin(0.6 * y + 1) * np.cos(0.6 * z) + 0.5 * np.sin(0.3 * x + 1) * np.sin(0.3 * y) * np.cos(0.3 * z)
    noisy = mesh.normals + 0.02 * np.random.default_rng(2).standard_normal(mesh.normals.shape)
    found = replace(mesh, normals=noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    fitted, _ = fit_normals(found, shaded(mesh.normals, np.log([0.6, 0.55, 0.5]) + paint[:, None]))
    assert angles(fitted.normals, found.normals).mean() < 1


def test_a_painted_sphere_keeps_its_normals():
    mesh = sphere(5)
    x, y, z = mesh.vertices.T / SurfaceGradient.of(mesh).length
    smooth = np.stack([np.sin(0.6 * x), np.sin(0.5 * y + 1), np.sin(0.7 * z)], 1) * 0.3
    patches = np.where((np.sin(0.4 * x) * np.sin(0.4 * z) > 0.3)[:, None], np.log([0.05, 0.05, 0.06]), np.log([0.7, 0.65, 0.5]))
    fitted, _ = fit_normals(mesh, shaded(mesh.normals, smooth + patches))
    assert angles(fitted.normals, mesh.normals).mean() < 0.5


def test_unseen_vertices_keep_their_normals():
    mesh = sphere(3)
    shading = DiffuseShading(np.zeros((len(mesh.vertices), 3)), np.zeros(len(mesh.vertices)), light(len(mesh.vertices)))
    assert fit_normals(mesh, shading)[0].normals == pytest.approx(mesh.normals, abs=1e-6)


def test_strong_relief_loosens_its_own_prior():
    assert slope_deviation(np.full((10, 3), 1e-3)) == SLOPE_DEVIATION
    assert slope_deviation(np.full((10, 3), 10.0)) == MAX_SLOPE_DEVIATION
    assert SLOPE_DEVIATION < slope_deviation(np.full((10, 3), 0.04)) < MAX_SLOPE_DEVIATION
    assert slope_deviation(np.zeros((0, 3))) == SLOPE_DEVIATION
