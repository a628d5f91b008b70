# SPDX-License-Identifier: GPL-3.0-or-later
"""Previews of a stage's current result: images, and the object's shape."""

from __future__ import annotations

import numpy as np
import torch

from ...io.quantisation import eight_bits
from ...io.srgb import encode_srgb
from ...rendering.gbuffer import render_gbuffer
from ...scene.camera import Camera
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...scene.reconstruction import Reconstruction
from ...scene.spherical_harmonics import SH_C0
from ...scene.surface import Surface

MAX_IMAGE_SIDE = 256  # pixels along the longer side
MAX_POINTS = 10_000  # of a shape
MIN_OPACITY = 0.5  # least opacity of a surfel that is shown as a point


def preview_camera(camera: Camera) -> Camera:
    """Return the camera with an image of at most MAX_IMAGE_SIDE pixels along a side."""
    return camera.with_longest_side(min(MAX_IMAGE_SIDE, max(camera.width, camera.height)))


def albedo_image(reconstruction: Reconstruction, camera: Camera) -> np.ndarray:
    """Render the albedo, the unknown that the second stage solves for.

    Args:
        reconstruction: current result.
        camera: view, whose image size is reduced by `preview_camera`.

    Returns:
        (H, W, 3) uint8, sRGB-encoded, on black.
    """
    layers = render_gbuffer(reconstruction, preview_camera(camera))
    return eight_bits(encode_srgb(np.clip(layers.albedo, 0, 1)) * np.clip(layers.alpha, 0, 1)[..., None])


def points_shape(gaussians: Gaussians, dataset: Dataset) -> dict[str, np.ndarray]:
    """Sample surfels as points with their mean radiance, evenly among the opaque ones in the object's bound.

    Args:
        gaussians: current result.
        dataset: dataset with the object's bound.

    Returns:
        The shape as `Progress.shape` describes it.
    """
    position, centre = gaussians.position.detach().cpu(), torch.tensor(dataset.bound.centre)
    inside = (position.T - centre).norm(dim=1) < dataset.bound.radius
    shown = torch.nonzero(inside & (gaussians.opacity.detach().cpu().sigmoid() > MIN_OPACITY))[:, 0]
    shown = shown[:: -(-len(shown) // MAX_POINTS) or 1]
    radiance = (SH_C0 * gaussians.sh[0].detach().cpu()[:, shown] + 0.5).clamp(0, 1).T.numpy()
    return {"position": position.T[shown].contiguous().numpy(), "colour": encode_srgb(radiance).astype(np.float32), **_frame(dataset)}


def surface_shape(surface: Surface, dataset: Dataset) -> dict[str, np.ndarray]:
    """Return a surface as the shape that `Progress.shape` describes, in grey.

    Args:
        surface: fused from the first stage's depth.
        dataset: dataset with the object's bound.
    """
    vertices, faces = np.asarray(surface.vertices, np.float32), np.asarray(surface.faces, np.int32)
    return {"position": vertices, "colour": np.full_like(vertices, 0.6), "faces": faces, **_frame(dataset)}


def _frame(dataset: Dataset) -> dict[str, np.ndarray]:
    return {"centre": np.array(dataset.bound.centre), "to_world": np.asarray(dataset.to_world, np.float64)}
