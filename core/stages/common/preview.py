# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview images of a stage's current result."""

from __future__ import annotations

import numpy as np

from ...io.srgb import encode_srgb
from ...rendering.gbuffer import render_gbuffer
from ...scene.camera import Camera
from ...scene.reconstruction import Reconstruction

LONGEST = 256  # pixels along the longer side


def preview_camera(camera: Camera) -> Camera:
    """Return the camera with an image of at most LONGEST pixels along a side."""
    factor = LONGEST / max(camera.width, camera.height, LONGEST)
    return camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))


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


def eight_bits(image: np.ndarray) -> np.ndarray:
    """Convert values 0..1 (...,) to uint8 with rounding; NaN becomes 0."""
    return np.round(255 * np.clip(np.nan_to_num(image), 0, 1)).astype(np.uint8)
