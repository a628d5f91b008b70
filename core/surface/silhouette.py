# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouette offset: distance between the outlines of a mesh and of the images' masks, where the mesh has outlines.

Splatted surfels extend beyond the surface that they represent. A fit to silhouettes therefore places them, and the mesh fused from
their depth, a fraction of a pixel inside the object. The masks measure the distance: area between both outlines over outline length.
Each part of the mesh is measured by the outlines that run over it. Floors and hollows have none: their depth comes from colours that
agree between views, which has no such bias, and they stay where they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from ..scene.camera import Camera
from ..scene.triangle_tracer import TriangleTracer
from .topology import neighbour_average

MAX_OFFSET = 1.5  # pixels; a larger offset is not a bias of splatting, but a missing part
OUTLINE_REACH = 3.0  # pixels on both sides of the mesh's outline whose coverage is compared
SMOOTHING_PASSES = 10  # averages of a vertex's outlines with its neighbours'
HALF_MOVE_LENGTH = 0.1  # outline length at a vertex, over the mean of all vertices, that moves it by half of the measured distance


def silhouette_offset(vertices: np.ndarray, faces: np.ndarray, cameras: Sequence[Camera], masks: Sequence[np.ndarray]) -> np.ndarray:
    """Estimate the offset of each vertex along its outward normal that fills the masks.

    Args:
        vertices: (V, 3) of the mesh, world.
        faces: (F, 3).
        cameras: cameras of the images.
        masks: (H, W) opacity 0..1 of each camera's image.

    Returns:
        (V,) offsets in world units; 0 far from all outlines, and where no view shows an outline with a plausible offset.
    """
    tracer = TriangleTracer(vertices[faces])
    total, limits = np.zeros((len(vertices), 2)), []
    for camera, mask in zip(cameras, masks, strict=True):
        face, gaps, pixel = _gaps(tracer, camera, mask)
        area, length = gaps.sum(0) if len(gaps) else (0.0, 0.0)
        if length < pixel or abs(area) > MAX_OFFSET * pixel * length:
            continue
        limits.append(MAX_OFFSET * pixel)
        for corner, column in np.ndindex(3, 2):
            total[:, column] += np.bincount(faces[face, corner], gaps[:, column] / 3, len(vertices))
    if not limits:
        return np.zeros(len(vertices))
    limit = float(np.median(limits))
    return np.clip(_spread(total, faces), -limit, limit)


def _gaps(tracer: TriangleTracer, camera: Camera, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Compare the coverage of mesh and mask (H, W) in the pixels near the mesh's outline in one view.

    Returns:
        Index (P,) of the outline's triangle next to each of P pixels, their area of the mask without mesh and length of the mask's outline
        (P, 2) in world units, and the size of a pixel there (1 without outline).
    """
    found = tracer.seen_by(camera)
    face = found.triangle.reshape(mask.shape)
    hit = face >= 0
    edge = hit & (np.hypot(*np.gradient(hit.astype(np.float32))) > 0)
    if not edge.any():
        return np.zeros(0, np.int64), np.zeros((0, 2)), 1.0
    nearest = np.asarray(ndimage.distance_transform_edt(~edge, return_distances=False, return_indices=True))
    near = np.hypot(*(nearest - np.indices(mask.shape))) <= OUTLINE_REACH
    nearest = tuple(nearest[:, near])
    size = found.distance.reshape(mask.shape)[nearest] / camera.fx
    outline = np.hypot(*np.gradient(mask))[near]  # length in pixels: alpha rises by one across it
    gaps = np.stack([(mask - hit)[near] * size**2, outline * size], -1)
    return face[nearest], gaps.astype(np.float64), float(np.median(size))


def _spread(total: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Average area and outline length (V, 2) over neighbouring vertices of faces (F, 3), and return the distance (V,) that they measure."""
    matrix = neighbour_average(faces, len(total))
    least = HALF_MOVE_LENGTH * total[:, 1].mean()
    for _ in range(SMOOTHING_PASSES):
        total = matrix @ total
    return total[:, 0] / np.maximum(total[:, 1] + least, 1e-30)
