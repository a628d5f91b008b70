# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view sees of the mesh: its depth at the centres of the pixels, against the balls that the mesh stands for."""

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("engine")
BALLS = ((np.zeros(3), 1.0), (np.array([1.1, 0.0, 1.1]), 0.5))  # centre and radius of each


def depth_of_balls(camera) -> np.ndarray:
    """Planar depth (H, W) of the nearest ball at the centre of each pixel, infinite where there is none."""
    rays, nearest = camera.rays().astype(float), np.full((camera.height, camera.width), np.inf)
    for centre, radius in BALLS:
        to_centre = centre - camera.centre
        along, squared = rays @ to_centre, (rays**2).sum(-1)
        root = along**2 - squared * (to_centre @ to_centre - radius**2)
        nearest = np.minimum(nearest, np.where(root >= 0, (along - np.sqrt(np.maximum(root, 0))) / squared, np.inf))
    return nearest


def test_depth_is_that_of_the_mesh_at_the_centres_of_the_pixels(relighter, camera):
    truth = depth_of_balls(camera)
    by_mesh, by_surfels = (relighter(backend, balls=BALLS).gbuffer(camera) for backend in ("mesh", "gaussian"))
    shown = np.isfinite(truth) & (by_mesh.alpha > 0.99)
    assert shown.sum() > 1000
    error, of_surfels = (np.abs(one.depth - truth)[shown] for one in (by_mesh, by_surfels))
    assert error.max() < 0.003  # the mesh's triangles are flat
    assert 3 * np.median(error) < np.median(of_surfels)
