# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiometric correction of a photograph: exposure, and the low frequencies of the working solution for its albedo."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from ..scene.mesh import Mesh
from .mesh_depth import render_mesh_depth
from .photographs import LoadedPhotograph
from .vertex_shading import ViewShading

# Standard deviation of the low-pass filter, as a fraction of the image's longest side: wider than the Gaussians' blur.
LOW_PASS_FRACTION = 0.05
REDUCED_SIGMA = 4.0  # standard deviation of that filter in pixels of the reduced image that is filtered
MIN_OBJECT_ALPHA = 0.9  # alpha from which a pixel belongs to the object
MIN_CLIPPED_VALUE = 0.97  # linear value from which a pixel may be clipped
MIN_SHADING_FRACTION = 0.05  # fraction of the median shading below which a pixel's albedo is noise
MAX_FACTOR = 4.0  # largest factor, and the inverse of the least
MIN_PIXELS = 200  # pixels from which a photograph can be corrected
EDGE_PIXELS = 2.0  # pixels of the working resolution from a depth or mask edge, within which a photograph and the mesh may not match
MIN_DEPTH_STEP = 0.02  # relative difference of neighbouring depths beyond the slope that counts as an edge


@dataclass(frozen=True, eq=False)
class RadiometricCorrection:
    """Correction of one photograph at the working resolution.

    Attributes:
        gain: (3,) linear exposure gain of the photograph relative to the solution.
        low_frequency: (h, w, 3) float32 smooth factor of its albedo that gives it the low frequencies of the working solution.
        inside: (h, w) float32 weight in 0..1, 0 at edges of the depth and of the mask.
    """

    gain: np.ndarray
    low_frequency: np.ndarray
    inside: np.ndarray


def fit_correction(photograph: LoadedPhotograph, mesh: Mesh, albedo: np.ndarray, shading: ViewShading) -> RadiometricCorrection | None:
    """Fit the correction of a photograph.

    Args:
        photograph: decoded.
        mesh: mesh with UVs.
        albedo: (S, S, 3) float32 linear texture of the working solution.
        shading: shading of the mesh's vertices towards the photograph's camera.

    Returns:
        The correction, or None where too little of the object is seen.
    """
    view = render_mesh_depth(mesh.vertices, mesh.faces, photograph.camera)
    row, column = np.nonzero(view.triangle >= 0)
    values = np.concatenate([shading.factor, shading.gloss, mesh.uvs], -1)
    at = view.interpolate(values, mesh.faces, row, column)
    factor, gloss, solution = at[:, :3], at[:, 3:6], _looked_up(albedo, at[:, 6:])
    seen = photograph.reduced[row, column]
    inside = edge_weight(view.inverse, photograph.alpha)
    usable = (
        (inside[row, column] > 0)
        & (seen.max(-1) < MIN_CLIPPED_VALUE)
        & (factor.min(-1) > MIN_SHADING_FRACTION * max(float(np.median(factor)), 1e-9))
    )
    if usable.sum() < MIN_PIXELS:
        return None
    expected = solution * factor + gloss
    gain = np.median(seen[usable] / np.maximum(expected[usable], 1e-4), axis=0)
    gain = np.clip(gain, 1e-2, 1e2)
    observed = np.clip((seen / gain - gloss) / np.maximum(factor, 1e-6), 0, 2)
    images = np.zeros((*view.triangle.shape, 7), np.float32)
    chosen = row[usable], column[usable]
    images[chosen] = np.concatenate([solution[usable], observed[usable], np.ones((int(usable.sum()), 1))], -1)
    return RadiometricCorrection(gain, smooth_ratio(images, LOW_PASS_FRACTION * max(view.triangle.shape)), inside)


def smooth_ratio(images: np.ndarray, sigma: float) -> np.ndarray:
    """Return the ratio of two low-passed images, (h, w, 3) float32 within 1 / MAX_FACTOR..MAX_FACTOR.

    Args:
        images: (h, w, 7) numerator, denominator, and their common mask, 0 outside.
        sigma: standard deviation of the filter, pixels.
    """
    height, width = images.shape[:2]
    step = max(1, int(sigma / REDUCED_SIGMA))  # so smooth a result needs few pixels
    size = (-(-width // step), -(-height // step))
    parts = (images[..., :4], images[..., 4:])  # OpenCV averages at most four channels, unless the size is a multiple of the step
    small = np.dstack([cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in parts])
    smooth = cv2.GaussianBlur(small, (0, 0), sigma / step)
    # Far from all known pixels the ratio of the whole image takes over.
    mean = images.reshape(-1, 7).mean(0) * 1e-3
    ratio = (smooth[..., :3] + mean[:3]) / np.maximum(smooth[..., 3:6] + mean[3:6], 1e-9)
    ratio = np.clip(ratio, 1 / MAX_FACTOR, MAX_FACTOR).astype(np.float32)
    return cv2.resize(ratio, (width, height), interpolation=cv2.INTER_LINEAR) if step > 1 else ratio


def edge_weight(inverse: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    """Return a weight (h, w) float32 in 0..1 that falls to 0 at edges of the depth and of the mask.

    Args:
        inverse: (h, w) 1 / depth, 0 where nothing is.
        alpha: (h, w) mask, or None.
    """
    inside = inverse > 0
    if alpha is not None:
        inside &= alpha > MIN_OBJECT_ALPHA
    # On a plane, 1 / depth is linear in the image: its second difference is 0 there, and large at a step.
    near = np.maximum(inverse, 1e-12)
    for axis in (0, 1):
        before, after = np.roll(near, 1, axis), np.roll(near, -1, axis)
        inside &= np.abs(before + after - 2 * near) < MIN_DEPTH_STEP * near
    inside[[0, -1]], inside[:, [0, -1]] = False, False
    distance = np.asarray(ndimage.distance_transform_edt(inside))
    return np.clip((distance - 0.5) / EDGE_PIXELS - 0.5, 0, 1).astype(np.float32)


def _looked_up(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return the nearest texels (P, 3) of a texture at UVs (P, 2)."""
    size = len(texture)
    column = np.clip((uv[:, 0] * size).astype(int), 0, size - 1)
    row = np.clip(((1 - uv[:, 1]) * size).astype(int), 0, size - 1)
    return texture[row, column]
