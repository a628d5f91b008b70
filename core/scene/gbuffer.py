# SPDX-License-Identifier: GPL-3.0-or-later
"""G-buffer of a view, and the Gaussians of a reconstruction as surface samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .camera import Camera

CONFIDENCE = ("confidence_albedo", "confidence_roughness", "confidence_metallic")  # columns of PLY files where it is known
EMPTY_ALPHA = 0.5 / 255  # below this alpha a pixel is empty, and its layers are noise divided by almost zero


@dataclass(frozen=True, eq=False)
class GBuffer:
    """G-buffer of a reconstruction seen by a camera; float32, divided by accumulated alpha, 0 where alpha is 0.

    Attributes:
        camera: the camera; images are (H, W).
        alpha: (H, W) opacity in 0..1.
        depth: (H, W) planar depth, world units.
        normal: (H, W, 3) unit world normal; near outlines it may point slightly away from the camera.
        radiance: (H, W, 3) linear Rec.709.
        albedo: (H, W, 3) linear 0..1 (F0 where metallic).
        roughness, metallic: (H, W) in 0..1.
        background: (H, W, 3) linear radiance behind the object, or None where the photographs were masked.
        confidence: (H, W, 3) of albedo, roughness and metallic in 0..1, or None where it was not measured.
    """

    camera: Camera
    alpha: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    radiance: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    background: np.ndarray | None = None
    confidence: np.ndarray | None = None

    @property
    def image(self) -> np.ndarray:
        """Image (H, W, 4) of the Gaussians' own radiance, linear premultiplied; opaque where a background is known."""
        alpha = self.alpha[..., None]
        if self.background is None:
            return np.concatenate([self.radiance * alpha, alpha], -1)
        return np.concatenate([self.radiance * alpha + self.background * (1 - alpha), np.ones_like(alpha)], -1)


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Gaussians as points of a surface, used where no view sees it; float32.

    Attributes:
        position: (N, 3) world.
        normal: (N, 3) unit world; the side is undefined.
        opacity: (N,) in 0..1.
        albedo: (N, 3) linear 0..1.
        roughness, metallic: (N,) in 0..1.
    """

    position: np.ndarray
    normal: np.ndarray
    opacity: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
