# SPDX-License-Identifier: GPL-3.0-or-later
"""Material fusion: normals and materials of surface points from the views that see them, from the nearest Gaussians elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from ..kernels.cpu.jit import kernel
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.gbuffer import GBuffer, SurfaceSamples

MIN_FACING = 0.2  # least cosine between normal and view direction of a view that counts
NEAREST_GAUSSIANS = 8  # Gaussians that are averaged where no view sees a point
CHANNELS = 8  # normal xyz, albedo rgb, roughness, metallic; the confidence of the last three follows where it is known


@dataclass(frozen=True, eq=False)
class FusedMaterials:
    """Normals and materials of P surface points, float32.

    Attributes:
        normal: (P, 3) unit, world.
        albedo: (P, 3) linear 0..1.
        roughness: (P,) 0..1.
        metallic: (P,) 0..1.
        weight: (P,) sum of the views' weights; 0 where no view sees the point.
        material_confidence: (P, 3) of albedo, roughness and metallic, 0 where no view sees the point; None where it is not known.
    """

    normal: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    weight: np.ndarray
    material_confidence: np.ndarray | None = None

    @property
    def confidence(self) -> np.ndarray:
        """Confidence (P,) of the points: 0 where no view sees them, 0.5 for one view straight at them, towards 1 with their number."""
        return self.weight / (1 + self.weight)

    def at(self, index: np.ndarray) -> FusedMaterials:
        """Return the materials of the points with the given indices."""
        values = {name: None if value is None else value[index] for name, value in vars(self).items()}
        return replace(self, **values)


class ViewLayers(NamedTuple):
    """Layers of a view that points look up.

    Attributes:
        centre: (3,) of the camera, world.
        projection: (3, 4) from the world to pixels and planar depth.
        pixel: width of a pixel at depth 1.
        depth: (H, W) float32 planar depth.
        alpha: (H, W) float32, 0 where there is no depth.
        channels: (H, W, CHANNELS or more) float32 normal, materials and, where it is known, confidence.
    """

    centre: np.ndarray
    projection: np.ndarray
    pixel: float
    depth: np.ndarray
    alpha: np.ndarray
    channels: np.ndarray


def fuse_materials(
    points: np.ndarray,
    normals: np.ndarray,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    voxel: float,
    step: Callable[[int], None] = lambda done: None,
) -> FusedMaterials:
    """Fuse normals and materials of surface points.

    Args:
        points: (P, 3) world.
        normals: (P, 3) unit, of the mesh.
        views: G-buffers.
        samples: the Gaussians, for points that no view sees.
        voxel: resolution of the surface, world units; sets how far behind a view's depth a point may lie and still be seen.
        step: called with the number of views done; may raise.
    """
    points, normals = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(normals, np.float32)
    known = len(views) > 0 and views[0].confidence is not None
    total, weight = np.zeros((len(points), CHANNELS + 3 * known), np.float32), np.zeros(len(points), np.float32)
    ranges = even_ranges(len(points), 4 * thread_count())
    for done, view in enumerate(views):
        run_ranges(add_view, ranges, points, normals, voxel, _layers(view), total, weight)
        step(done + 1)
    unseen = weight <= 1e-6
    total /= np.where(unseen, 1, weight)[:, None]
    if unseen.any():
        total[unseen, :CHANNELS] = _nearest_samples(points[unseen], samples)
    materials = np.clip(total[:, 3:], 0, 1, out=total[:, 3:])
    normal, confidence = _oriented(total[:, :3], normals), materials[:, 5:] if known else None
    return FusedMaterials(normal, materials[:, :3], materials[:, 3], materials[:, 4], np.where(unseen, 0, weight), confidence)


def _layers(view: GBuffer) -> ViewLayers:
    """Return the layers of a view that points look up."""
    parts = [view.normal, view.albedo, view.roughness[..., None], view.metallic[..., None]]
    parts += [] if view.confidence is None else [view.confidence]
    return ViewLayers(
        centre=view.camera.centre,
        projection=view.camera.projection,
        pixel=max(1 / view.camera.fx, 1 / view.camera.fy),
        depth=np.ascontiguousarray(view.depth, np.float32),
        alpha=np.where(np.isfinite(view.depth) & (view.depth > 0), view.alpha, 0).astype(np.float32),
        channels=np.ascontiguousarray(np.concatenate(parts, -1), np.float32),
    )


def _oriented(fused: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return unit fused normals (P, 3) on the side of the mesh's normals (P, 3), which replace fused normals of zero length."""
    fused = np.where((fused * normals).sum(-1, keepdims=True) < 0, -fused, fused)
    length = np.linalg.norm(fused, axis=-1, keepdims=True)
    return np.where(length > 1e-6, fused / np.maximum(length, 1e-6), normals).astype(np.float32)


def _nearest_samples(points: np.ndarray, samples: SurfaceSamples) -> np.ndarray:
    """Average the nearest samples of points (P, 3), weighted by opacity, with normals flipped to one side: (P, CHANNELS)."""
    _, index = KDTree(samples.position).query(points, k=min(NEAREST_GAUSSIANS, len(samples.position)), workers=-1)
    index = index.reshape(len(points), -1)
    weight = (samples.opacity[index] + 1e-6)[..., None]
    normal = samples.normal[index]
    normal = np.where((normal * normal[:, :1]).sum(-1, keepdims=True) < 0, -normal, normal)
    materials = samples.albedo[index], samples.roughness[index][..., None], samples.metallic[index][..., None]
    values = np.concatenate([normal, *materials], -1)
    return (values * weight).sum(1) / weight.sum(1)


@kernel
def add_view(begin, end, points, normals, voxel, view, total, weight):
    """Add one view to the points begin..end: bilinear sums `total` (P, C) of pixels that show the point's surface, `weight` (P,)."""
    centre, matrix, pixel, depth, alpha, layers = view
    height, width = depth.shape
    for p in range(begin, end):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        far = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        if far <= 0:
            continue
        u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / far - 0.5
        v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / far - 0.5
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        dx, dy, dz = centre[0] - x, centre[1] - y, centre[2] - z
        facing = (dx * normals[p, 0] + dy * normals[p, 1] + dz * normals[p, 2]) / np.sqrt(dx * dx + dy * dy + dz * dz)
        if facing < MIN_FACING:
            continue
        tolerance = 2 * max(voxel, pixel * far)
        column, row = int(np.floor(u)), int(np.floor(v))
        for r in range(max(row, 0), min(row + 2, height)):
            for c in range(max(column, 0), min(column + 2, width)):
                # Measured along the normal: on a slanted surface the depth changes from pixel to pixel.
                if alpha[r, c] <= 0.5 or abs(depth[r, c] - far) * facing > tolerance:
                    continue
                # The far side of a thin part is as near, but faces the other way.
                if layers[r, c, 0] * normals[p, 0] + layers[r, c, 1] * normals[p, 1] + layers[r, c, 2] * normals[p, 2] <= 0:
                    continue
                w = facing * alpha[r, c] * (1 - abs(u - c)) * (1 - abs(v - r))
                weight[p] += w
                for k in range(layers.shape[2]):
                    total[p, k] += w * layers[r, c, k]
