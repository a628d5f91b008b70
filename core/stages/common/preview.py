# SPDX-License-Identifier: GPL-3.0-or-later
"""Small images of what a stage has so far, for whoever watches."""

from __future__ import annotations

import numpy as np

from ...io.srgb import encode_srgb
from ...rendering.gbuffer import render_gbuffer
from ...scene.camera import Camera
from ...scene.reconstruction import Reconstruction

LONGEST = 256  # pixels


def preview_camera(camera: Camera) -> Camera:
    """The camera with an image of at most LONGEST pixels along a side."""
    factor = LONGEST / max(camera.width, camera.height, LONGEST)
    return camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))


def albedo_image(reconstruction: Reconstruction, camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8 sRGB on black: the albedo, which is what the second stage finds."""
    layers = render_gbuffer(reconstruction, preview_camera(camera))
    return eight_bits(encode_srgb(np.clip(layers.albedo, 0, 1)) * np.clip(layers.alpha, 0, 1)[..., None])


def eight_bits(image: np.ndarray) -> np.ndarray:
    """Values 0..1 as uint8."""
    return np.round(255 * np.clip(np.nan_to_num(image), 0, 1)).astype(np.uint8)
