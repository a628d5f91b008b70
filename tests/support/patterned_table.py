# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of a ball on a table of known pattern, with true masks."""

import numpy as np
from irgspp.core.capture.support_plane import SupportPlane
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound

WIDTH, HEIGHT = 120, 90
PLANE = SupportPlane(np.array([0.0, 0, 1]), 0.0, 0.001, np.zeros((0, 3)))
BOUND = Bound((0.0, 0.0, 0.3), 0.4)


def pattern(x, y):
    """Encoded colours (..., 3) of the table at world places."""
    wave = np.sin(9 * x + 4 * y) * np.cos(3 * x - 7 * y)
    return np.stack([0.5 + 0.3 * wave, 0.45 + 0.2 * np.sin(5 * y), 0.3 + 0.1 * wave], -1)


def cameras(count=10):
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    eyes = [(2.2 * np.cos(a), 2.2 * np.sin(a), 1.2 + 0.3 * np.sin(3 * a)) for a in around]
    return [Camera(WIDTH, HEIGHT, 110.0, 110.0, 60.0, 45.0, look_at(eye, (0, 0, 0.2))) for eye in eyes]


def on_table(camera):
    """Places (H, W) x and y where the rays meet the table."""
    rays = camera.rays()
    far = -camera.centre[2] / np.minimum(rays[..., 2], -1e-3)
    place = camera.centre + far[..., None] * rays
    return place[..., 0], place[..., 1]


def photographs(cams, object_colour=None, gains=1.0):
    """Photographs (H, W, 3) and masks (H, W) of a ball of one colour, or of the table's own pattern, on the table."""
    colours, masks = [], []
    for camera, gain in zip(cams, np.broadcast_to(gains, len(cams)), strict=True):
        rays, to = camera.rays(), np.array([0, 0, 0.25]) - camera.centre
        along = (rays @ to) ** 2 / (rays * rays).sum(-1)
        mask = (to @ to - along < 0.25**2).astype(np.float32)
        colour = pattern(*on_table(camera))
        if object_colour is not None:
            colour = np.where(mask[..., None] > 0, object_colour, colour)
        colours.append(np.clip(gain * colour, 0, 1).astype(np.float32))
        masks.append(mask)
    return colours, masks
