# SPDX-License-Identifier: GPL-3.0-or-later
"""Open bowl, which no silhouette shows to be hollow: the lower part of the unit sphere."""

from pathlib import Path

import numpy as np
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.stereo.depth_map import DepthMap

RIM = 0.2  # height up to which the unit sphere is there
_draw = np.random.default_rng(3)
_direction = _draw.normal(size=(3, 24))
WAVES = _direction / np.linalg.norm(_direction, axis=0) * _draw.uniform(8, 24, 24)
PHASES = _draw.uniform(0, 2 * np.pi, 24)


def bowl_depth(camera, rays):
    """Depth along rays (..., 3) of z = 1 to the unit sphere below RIM, inside or outside; 0 where they miss it."""
    origin = camera.centre
    a, b, c = (rays * rays).sum(-1), (rays * origin).sum(-1), origin @ origin - 1
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    near, far = (-b - root) / a, (-b + root) / a
    below = [origin[2] + t * rays[..., 2] < RIM for t in (near, far)]
    return np.where(b * b > a * c, np.where(below[0], near, np.where(below[1], far, 0)), 0)


def bowl(masked=True, textured=True, count=20, size=72):
    """Dataset of the bowl, seen from above and from the side."""
    views = []
    for i in range(count):
        z, angle = 0.95 - 0.85 * (i + 0.5) / count, i * 2.399963
        place = 4 * np.array([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])
        camera = Camera(size, size, 1.4 * size, 1.4 * size, size / 2, size / 2, look_at(place, np.zeros(3)))
        fine = camera.resized(3 * size, 3 * size).rays().astype(np.float64)
        depth = bowl_depth(camera, fine)
        points = camera.centre + depth[..., None] * fine
        grey = 0.5 + (0.08 * np.sin(points @ WAVES + PHASES).sum(-1) if textured else 0)
        alpha = (depth > 0).reshape(size, 3, size, 3).mean((1, 3)).astype(np.float32)
        grey = np.where(depth > 0, grey, 0).reshape(size, 3, size, 3).mean((1, 3)) / (np.maximum(alpha, 1e-9) if masked else 1)
        colour = np.repeat(np.clip(grey, 0, 1)[..., None], 3, -1).astype(np.float32)
        views.append(View(f"{i}", camera, Path(f"{i}.png"), colour, alpha if masked else None))
    return Dataset(Path("bowl"), "transforms", views, [], Bound((0.0, 0.0, -0.3), 1.2), np.eye(4))


def guessed_inside(views, *_):
    """Exact depth maps of the bowl, in which other views agree with the outside alone."""
    maps = []
    for view in views:
        rays = view.camera.rays().astype(np.float64)
        depth = bowl_depth(view.camera, rays)
        points = view.camera.centre + depth[..., None] * rays
        inside = (points * rays).sum(-1) > 0
        normal = np.where(inside[..., None], -points, points) * (depth > 0)[..., None]
        support = np.where(depth > 0, np.where(inside, 1, 5), 0).astype(np.uint8)
        others = tuple(k for k in range(len(views)) if views[k] is not view)
        maps.append(
            DepthMap(view.camera, depth.astype(np.float32), normal.astype(np.float32), np.zeros_like(depth, np.float32), support, others)
        )
    return maps
