# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal images of a sphere against the analytic ones."""

import numpy as np
import trimesh
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.surface import Surface
from irgspp.core.surface.normal_images import normal_images


def test_normals_of_a_sphere_are_its_points():
    mesh = trimesh.creation.icosphere(4)
    vertices = np.asarray(mesh.vertices)
    camera = Camera(40, 30, 60, 60, 20, 15, look_at(np.array([1.0, -3.0, 1.5]), np.zeros(3)))
    (image,) = normal_images(Surface(vertices, vertices, np.asarray(mesh.faces), 0.1), [camera])
    rays = camera.rays().astype(np.float64)
    a, b, c = (rays**2).sum(-1), (rays * camera.centre).sum(-1), camera.centre @ camera.centre - 1
    inside = b * b - a * c
    points = camera.centre + ((-b - np.sqrt(np.maximum(inside, 0))) / a)[..., None] * rays
    clear = inside > 0.2
    assert image.shape == (30, 40, 3)
    assert clear.sum() > 200
    assert (image[clear] * points[clear]).sum(-1).min() > 0.999
    assert not image[inside < -0.2].any()


def test_the_back_of_a_surface_has_no_normal():
    vertices = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    surface = Surface(vertices, np.tile([[0.0, 0, 1]], (3, 1)), np.array([[0, 1, 2]]), 0.1)
    cameras = [Camera(8, 8, 8, 8, 4, 4, look_at(np.array([0, 0, z]), np.zeros(3), up=(0, 1, 0))) for z in (5.0, -5.0)]
    front, back = normal_images(surface, cameras)
    assert np.allclose(front[4, 4], [0, 0, 1])
    assert not back.any()
