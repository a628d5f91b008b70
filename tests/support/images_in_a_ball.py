# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball in a matt shell, as stereo sees it: virtual images inside the ball, and the shell beside them."""

from pathlib import Path

import numpy as np
import torch
from irgspp.core.scene.dataset import View
from irgspp.core.stages.first.depth_anchors import COMPARED_VIEWS, DepthAnchors

CENTRE, RADIUS, SHELL = np.array([0.1, -0.05, 0.08]), 0.3, 1.2  # of the ball, and of the shell around it
IMAGES = 0.75  # radii of the ball from its centre to the images


def entered(camera, centre, radius, far=False):
    """Planar depths (H, W) at which rays enter, or leave, a sphere; NaN where they miss it."""
    rays, offset = camera.rays().astype(float), camera.centre - centre
    a, b, c = (rays**2).sum(-1), (rays * offset).sum(-1), offset @ offset - radius**2
    root = b * b - a * c
    return np.where(root > 0, (-b + (1 if far else -1) * np.sqrt(np.maximum(root, 0))) / a, np.nan)


def anchored(depths):
    """Anchors of a stereo that knows planar depths (H, W) of each view, NaN for none."""
    pixels = [np.flatnonzero(np.isfinite(depth)) for depth in depths]
    begin = torch.from_numpy(np.cumsum([0, *(len(pixel) for pixel in pixels)]))
    depth = np.concatenate([one.reshape(-1)[pixel] for one, pixel in zip(depths, pixels, strict=True)]).astype(np.float32)
    joined = torch.from_numpy(np.concatenate(pixels).astype(np.int32)), torch.from_numpy(depth)
    return DepthAnchors(begin, *joined, torch.full((len(depths), COMPARED_VIEWS), -1))


def blank(cameras):
    """Views without pictures."""
    return [View("0", camera, Path("0.png"), np.zeros((camera.height, camera.width, 3), np.float32), None) for camera in cameras]


def images_in_a_ball(cameras):
    """Blank views, anchors, and the points (N, 3) of the images."""
    depths, region = [], []
    for camera in cameras:
        ball, shell = entered(camera, CENTRE, RADIUS), entered(camera, np.zeros(3), SHELL, far=True)
        image = entered(camera, CENTRE, IMAGES * RADIUS)
        depths.append(np.where(np.isfinite(ball), image, shell))
        region.append((camera.centre + camera.rays() * image[..., None])[np.isfinite(image)])
    return blank(cameras), anchored(depths), np.concatenate(region)
