# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of a chrome sphere, made without a renderer."""

from pathlib import Path

import numpy as np
from irgspp.core.scene.dataset import Bound, Dataset, View

BOUND = Bound((0.0, 0.0, 0.0), 1.5)


def mirror_photographs(cameras, masks) -> Dataset:
    """Render a chrome sphere under hard stripes of light, which reflections explain and no smooth function of the view direction does."""
    views = []
    for camera, mask in zip(cameras, masks, strict=True):
        rays = camera.rays().astype(np.float64)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        b = rays @ camera.centre
        t = -b - np.sqrt(np.maximum(b * b - camera.centre @ camera.centre + 1, 0))
        normal = camera.centre + t[..., None] * rays
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        mirrored = rays - 2 * (rays * normal).sum(-1, keepdims=True) * normal
        bright = np.sin(5 * np.arctan2(mirrored[..., 1], mirrored[..., 0])) > 0
        colour = np.where(bright[..., None], [0.9, 0.8, 0.6], [0.25, 0.2, 0.15]).astype(np.float32)
        views.append(View(f"{len(views)}", camera, Path("a.png"), colour, mask))
    return Dataset(Path("mirror"), "transforms", views, [], BOUND, np.eye(4))
