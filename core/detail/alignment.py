# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment of a photograph to the texture: a smooth displacement that errors of its pose and of the mesh explain."""

from __future__ import annotations

import cv2
import numpy as np

from ..scene.camera import Camera
from ..scene.mesh import Mesh
from .mesh_depth import MeshDepth, render_mesh_depth
from .photographs import LoadedPhotograph
from .radiometric_correction import RadiometricCorrection
from .vertex_shading import ViewShading

MAX_SIDE = 1280  # longest side of the images that are aligned, pixels
MAX_DISPLACEMENT = 3.0  # pixels of the working resolution; more is no small error
SMOOTHING_FRACTION = 0.012  # standard deviation of the displacement's filter, as a fraction of the longest side
HALF_WEIGHT_CONTRAST = 0.02  # standard deviation of encoded albedo around a pixel at which its displacement counts half
MAX_DIFFERENCE_RATIO = 0.98  # difference after the displacement over that before, below which it is used
PATCH_SIGMA = 5.0  # standard deviation of that neighbourhood, pixels


def displacement(
    photograph: LoadedPhotograph, mesh: Mesh, albedo: np.ndarray, known: np.ndarray, shading: ViewShading, correction: RadiometricCorrection
) -> np.ndarray:
    """Find where a photograph shows the texture, by dense optical flow (Kroeger et al. 2016) and a filter that contrast weights.

    Args:
        photograph: decoded.
        mesh: mesh with UVs.
        albedo: (S, S, 3) float32 linear texture with detail.
        known: (S, S) bool, texels that photographs show.
        shading: shading of the mesh's vertices towards the camera.
        correction: correction of the photograph.

    Returns:
        (h, w, 2) float32 displacement in pixels of the working resolution; 0 where nothing is seen.
    """
    working = photograph.camera
    camera = _enlarged(working, photograph.lens.size)
    view = render_mesh_depth(mesh.vertices, mesh.faces, camera)
    shown, inside = rendered_albedo(view, mesh, albedo, known)
    seen = _observed_albedo(photograph, view, mesh, shading, correction)
    inside &= cv2.resize(correction.inside, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR) > 0
    # The same values outside, so that nothing there draws the flow.
    shown, seen = (np.where(inside, np.sqrt(np.clip(image, 0, 1)), 0.5).astype(np.float32) for image in (shown, seen))
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    before, after = ((255 * image).astype(np.uint8) for image in (shown, seen))
    flow = search.calc(before, after, np.zeros((*before.shape, 2), np.float32))
    scale = working.width / camera.width
    weight = inside * _confidence(shown) * (np.linalg.norm(flow, axis=-1) * scale < MAX_DISPLACEMENT)
    sigma = SMOOTHING_FRACTION * max(camera.width, camera.height)
    layers = np.dstack([flow * weight[..., None], weight]).astype(np.float32)
    layers = cv2.GaussianBlur(cv2.resize(layers, (working.width, working.height), interpolation=cv2.INTER_AREA), (0, 0), sigma * scale)
    smooth = layers[..., :2] / np.maximum(layers[..., 2:], 1e-3)
    before, after = _differences(shown, seen, inside, cv2.resize(smooth, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR))
    if after > MAX_DIFFERENCE_RATIO * before:
        return np.zeros((working.height, working.width, 2), np.float32)
    return (scale * smooth).astype(np.float32)


def _differences(shown: np.ndarray, seen: np.ndarray, inside: np.ndarray, flow: np.ndarray) -> tuple[float, float]:
    """Return the mean absolute difference of two images (H, W) inside, before and after the second is displaced by `flow` (H, W, 2)."""
    row, column = np.indices(shown.shape)
    maps = [(place + flow[..., axis]).astype(np.float32) for axis, place in enumerate((column, row))]
    moved = cv2.remap(seen, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return float(np.abs(seen - shown)[inside].sum()), float(np.abs(moved - shown)[inside].sum())


def _enlarged(camera: Camera, full: tuple[int, int]) -> Camera:
    """Return the camera at the resolution of the alignment: at most MAX_SIDE and at most that of the photograph."""
    longest = max(camera.width, camera.height)
    scale = max(min(max(full), MAX_SIDE) / longest, 1.0)
    return camera.resized(round(camera.width * scale), round(camera.height * scale))


def rendered_albedo(view: MeshDepth, mesh: Mesh, albedo: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Render green of a texture, and where it is known.

    Args:
        view: depth map of the mesh.
        mesh: mesh with UVs.
        albedo: (S, S, 3) linear texture.
        known: (S, S) bool.

    Returns:
        (H, W) float32, and (H, W) bool.
    """
    row, column = np.nonzero(view.triangle >= 0)
    uv = view.interpolate(mesh.uvs, mesh.faces, row, column)
    size = len(albedo)
    u, v = np.clip((uv[:, 0] * size).astype(int), 0, size - 1), np.clip(((1 - uv[:, 1]) * size).astype(int), 0, size - 1)
    image, inside = np.zeros(view.triangle.shape, np.float32), np.zeros(view.triangle.shape, bool)
    image[row, column], inside[row, column] = albedo[v, u, 1], known[v, u]
    return image, inside


def _observed_albedo(
    photograph: LoadedPhotograph, view: MeshDepth, mesh: Mesh, shading: ViewShading, correction: RadiometricCorrection
) -> np.ndarray:
    """Return green of the albedo (H, W) that a photograph shows, undistorted, at the resolution of a depth map."""
    size = view.camera.width, view.camera.height
    image = photograph.undistorted(view.camera)[..., 1]
    row, column = np.nonzero(view.triangle >= 0)
    values = np.stack([shading.factor[:, 1], shading.gloss[:, 1]], -1)
    at = view.interpolate(values, mesh.faces, row, column)
    factor = cv2.resize(correction.low_frequency[..., 1], size, interpolation=cv2.INTER_LINEAR)
    albedo = np.zeros(view.triangle.shape, np.float32)
    seen = image[row, column] / correction.gain[1]
    albedo[row, column] = (seen - at[:, 1]) / np.maximum(at[:, 0], 1e-6) * factor[row, column]
    return albedo


def _confidence(image: np.ndarray) -> np.ndarray:
    """Return a weight (H, W) in 0..1 that grows with the contrast around a pixel."""
    mean = cv2.GaussianBlur(image, (0, 0), PATCH_SIGMA)
    variance = np.clip(cv2.GaussianBlur(image * image, (0, 0), PATCH_SIGMA) - mean * mean, 0, None)
    return variance / (variance + HALF_WEIGHT_CONTRAST**2)
