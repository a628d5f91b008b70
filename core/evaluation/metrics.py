# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of merit, as published inverse-rendering tables define them.

Pictures are compared sRGB-encoded, clipped to 0..1 and set on black by their own alpha, so that a wrong silhouette costs. Albedo is
compared linear, times the true alpha, after one scale per channel: under an unknown light its brightness is not observable.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree
from skimage.metrics import structural_similarity
from skimage.transform import resize

from ..colour import encode_srgb
from ..scene.mesh import Mesh

SSIM_WINDOW = 11  # pixels that a picture must have along each side


def shown(figure: float) -> str:
    """A figure as text; counts without decimals."""
    return str(figure) if isinstance(figure, int) else f"{figure:.4f}"


def on_black(rgba: np.ndarray) -> np.ndarray:
    """Linear premultiplied (H, W, 4) to encoded (H, W, 3) in 0..1, times alpha."""
    rgba = np.nan_to_num(rgba.astype(np.float64), nan=0.0, posinf=1.0, neginf=0.0)
    alpha = np.clip(rgba[..., 3:], 0, 1)
    straight = np.where(alpha > 1e-6, rgba[..., :3] / np.maximum(alpha, 1e-6), 0)
    return encode_srgb(np.clip(straight, 0, 1)) * alpha


def psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 1, at most 100; over the pixels of `mask` (H, W) where it is given."""
    error = np.square(a.astype(np.float64) - b)
    return float(-10 * np.log10(max((error if mask is None else error[mask]).mean(), 1e-10)))


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Structural similarity of (H, W, 3) pictures in 0..1, with the usual Gaussian window of 1.5 px."""
    window = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    value = structural_similarity(a.astype(np.float64), b.astype(np.float64), channel_axis=-1, data_range=1.0, **window)
    return float(np.asarray(value))


def normal_angles(normals: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W) angles in degrees between normal maps (H, W, 3); 90 where there is no normal."""
    n, t = normals.astype(np.float64), truth.astype(np.float64)
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(n, t), axis=-1), (n * t).sum(-1)))
    return np.where(np.linalg.norm(n, axis=-1) > 1e-6, angle, 90.0)


def albedo_scale(albedos: Sequence[np.ndarray], truths: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> np.ndarray:
    """(3,) median of truth / albedo per channel over the masked pixels of all views (linear (H, W, 3) pictures)."""
    pixels = zip(albedos, truths, masks, strict=True)
    ratio = np.concatenate([truth[mask].astype(np.float64) / np.maximum(albedo[mask], 1e-6) for albedo, truth, mask in pixels])
    return np.median(ratio[np.isfinite(ratio).all(-1)], axis=0)


def environment_figures(light: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """PSNR and SSIM of light maps (H, W, 3), encoded and clipped, on the grid of the true one, after a least-squares scale per channel.

    The scale is weighted by solid angle; `environment_psnr_unscaled` is without it.
    """
    height, width = truth.shape[:2]
    reduced = resize(light.astype(np.float64), (height, width), order=1, mode="edge", anti_aliasing=light.shape[0] > height)
    light = np.nan_to_num(np.asarray(reduced))
    weight = np.sin((np.arange(height) + 0.5) * np.pi / height)[:, None, None]
    scale = (weight * truth * light).sum((0, 1)) / np.maximum((weight * light * light).sum((0, 1)), 1e-12)
    scaled, plain, true = (encode_srgb(np.clip(picture, 0, 1)) for picture in (light * scale, light, truth))
    figures = {"environment_psnr": psnr(scaled, true), "environment_psnr_unscaled": psnr(plain, true)}
    return figures | ({"environment_ssim": ssim(scaled, true)} if min(height, width) >= SSIM_WINDOW else {})


def mesh_distances(mesh: Mesh, points: np.ndarray, normals: np.ndarray, near: float = 0.1, samples: int = 300_000) -> dict[str, float]:
    """Point-to-plane distances between a mesh and samples (N, 3) of the true surface that the cameras saw, in scene units.

    `mesh_completeness` is truth to mesh; `mesh_accuracy` mesh to truth, of mesh points within `near` of the seen surface;
    `mesh_stray` the share beyond; `mesh_chamfer` the mean of the first two.
    """
    points, normals = points.astype(np.float64), normals.astype(np.float64)
    surface, facing = _surface_samples(mesh, samples)
    _, nearest = KDTree(surface).query(points)
    completeness = np.abs(((surface[nearest] - points) * facing[nearest]).sum(-1)).mean()
    distance, nearest = KDTree(points).query(surface)
    seen = distance < near
    accuracy = np.abs(((surface - points[nearest]) * normals[nearest]).sum(-1))[seen].mean() if seen.any() else np.inf
    return {
        "mesh_completeness": float(completeness),
        "mesh_accuracy": float(accuracy),
        "mesh_chamfer": float((completeness + accuracy) / 2),
        "mesh_stray": float(1 - seen.mean()),
        "mesh_triangles": len(mesh.faces),
    }


def _surface_samples(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Area-uniform points on the triangles and the triangles' normals there, always the same."""
    a, b, c = mesh.vertices.astype(np.float64)[mesh.faces].transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=-1)
    random = np.random.default_rng(0)
    pick = random.choice(len(area), count, p=area / area.sum())
    r, s = np.sqrt(random.random(count))[:, None], random.random(count)[:, None]
    return (1 - r) * a[pick] + r * (1 - s) * b[pick] + r * s * c[pick], cross[pick] / np.maximum(area[pick], 1e-20)[:, None]
