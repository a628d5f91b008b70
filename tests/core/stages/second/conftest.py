# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere as reconstruction and surface, for tests of the second stage."""

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surface import Surface
from scipy.spatial import ConvexHull

SPHERE = Bound((0.0, 0.0, 0.0), 1.5)


@pytest.fixture(scope="module")
def sphere(splat_sphere):
    """Function that makes a reconstruction of the unit sphere (glossy or not), and the surface."""
    splats = splat_sphere(3000, opacity=0.999)
    points = splats.position.T.double().numpy()
    faces = ConvexHull(points).simplices

    def make(glossy=False, background=None):
        return Reconstruction(splats, torch.ones(8, 16, 3), SPHERE, np.eye(4), glossy, background)

    return make, Surface(points, points, faces, 0.05)
