# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouette offset: distance between the outlines of a mesh and of the images' masks.

Splatted surfels extend beyond the surface that they represent. A fit to silhouettes therefore places them, and the mesh fused from
their depth, a fraction of a pixel inside the object. The masks measure the distance: area between both outlines over outline length.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ..scene.camera import Camera

LARGEST = 1.5  # pixels; a larger offset is not a bias of splatting, but a missing part


def silhouette_offset(vertices: np.ndarray, faces: np.ndarray, cameras: Sequence[Camera], masks: Sequence[np.ndarray]) -> float:
    """Estimate the offset of the surface along its outward normals that fills the masks.

    Args:
        vertices: (V, 3) of the mesh, world.
        faces: (F, 3).
        cameras: of the images.
        masks: (H, W) opacity 0..1 of each camera's image.

    Returns:
        The median offset over the views in world units; 0 where it is implausibly large or no view shows an outline.
    """
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(vertices[faces], np.float32))
    gaps, pixels = [], []
    for camera, mask in zip(cameras, masks, strict=True):
        gap, pixel = _gap(scene, camera, mask)
        if pixel > 0:
            gaps.append(gap)
            pixels.append(pixel)
    if not gaps:
        return 0.0
    offset = float(np.median(gaps))
    return offset if abs(offset) <= LARGEST * float(np.median(pixels)) else 0.0


def _gap(scene: EmbreeScene, camera: Camera, mask: np.ndarray) -> tuple[float, float]:
    """Return the mean distance of the outlines of mesh and mask (H, W) in one view and the size of a pixel there (0 without outline)."""
    rays = camera.rays().reshape(-1, 3)
    origins = np.repeat(camera.centre[None].astype(np.float32), len(rays), 0)
    result = scene.run(origins, rays, query="INTERSECT", output=True)
    hit = (result["primID"] >= 0).reshape(mask.shape)
    outline = float(np.hypot(*np.gradient(mask)).sum())  # length in pixels: alpha rises by one across it
    edge = hit & (np.hypot(*np.gradient(hit.astype(np.float32))) > 0)
    if outline < 1 or not edge.any():
        return 0.0, 0.0
    pixel = float(np.median(result["tfar"].reshape(mask.shape)[edge])) / camera.fx
    return (float(mask.sum()) - float(hit.sum())) / outline * pixel, pixel
