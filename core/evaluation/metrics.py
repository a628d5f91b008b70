# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of merit of arrays; what they are computed of is the protocol's choice (protocols.py)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree
from skimage.transform import resize

from ..io.srgb import encode_srgb
from ..scene.mesh import Mesh

SSIM_WINDOW = 11  # pixels that an image must have along each side


def shown(figure: float) -> str:
    """A figure as text; counts without decimals, what four decimals don't show with a power of ten."""
    if isinstance(figure, int):
        return str(figure)
    return f"{figure:.2e}" if 0 < abs(figure) < 1e-3 else f"{figure:.4f}"


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


def ssim(a: np.ndarray, b: np.ndarray, window: int = SSIM_WINDOW) -> float:
    """Structural similarity of (H, W, 3) images in 0..1, Gaussian window of sigma 1.5 px cut off to `window` (odd) pixels.

    With the usual window of 11 the mean is over pixels whose window lies inside, as in Wang et al. 2004; with another one over all,
    images mirrored at their edges, as kornia has it.
    """
    radius = window // 2
    a, b = a.astype(np.float64), b.astype(np.float64)

    def local(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, (1.5, 1.5, 0), radius=(radius, radius, 0), mode="mirror")

    mean_a, mean_b = local(a), local(b)
    variances = local(a * a) - mean_a**2 + local(b * b) - mean_b**2
    covariance = local(a * b) - mean_a * mean_b
    similarity = (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4) / ((mean_a**2 + mean_b**2 + 1e-4) * (variances + 9e-4))
    inner = slice(radius, -radius) if window == SSIM_WINDOW else slice(None)
    return float(similarity[inner, inner].mean())


def normal_angles(normals: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W) angles in degrees between normal maps (H, W, 3); 90 where there is no normal."""
    n, t = normals.astype(np.float64), truth.astype(np.float64)
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(n, t), axis=-1), (n * t).sum(-1)))
    return np.where(np.linalg.norm(n, axis=-1) > 1e-6, angle, 90.0)


def fitted_scale(values: np.ndarray, truth: np.ndarray, weight: np.ndarray | float = 1.0) -> np.ndarray:
    """(C,) factors that bring (..., C) values closest to the truth, by least squares per channel; `weight` broadcasts."""
    axes = tuple(range(values.ndim - 1))
    values, truth = values.astype(np.float64), truth.astype(np.float64)
    return (weight * truth * values).sum(axes) / np.maximum((weight * values * values).sum(axes), 1e-12)


def albedo_scale(
    albedos: Sequence[np.ndarray],
    truths: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fit: Literal["median", "least squares"] = "median",
) -> np.ndarray:
    """(3,) factor per channel over the masked pixels of all views (linear (H, W, 3) images): median of truth / albedo, or least squares.

    1 where no pixel is masked.
    """
    ours = np.concatenate([albedo[mask] for albedo, mask in zip(albedos, masks, strict=True)]).astype(np.float64)
    true = np.concatenate([truth[mask] for truth, mask in zip(truths, masks, strict=True)]).astype(np.float64)
    if not len(ours):
        return np.ones(3)
    if fit == "least squares":
        return fitted_scale(ours, true)
    ratio = true / np.maximum(ours, 1e-6)
    return np.median(ratio[np.isfinite(ratio).all(-1)], axis=0)


def eroded(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: what lies at least 2 pixels (of a square) inside the mask; outside the image everything counts as inside."""
    return cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def cosine_distance(normals: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Mean of 1 - cosine between normal maps (H, W, 3) over a mask; 1 where there is no normal."""
    n, t = (v[mask].astype(np.float64) / (np.linalg.norm(v[mask], axis=-1, keepdims=True) + 1e-6) for v in (normals, truth))
    return float(1 - (n * t).sum(-1).mean())


def environment_figures(light: np.ndarray, truth: np.ndarray, grid: tuple[int, int] | None = None) -> dict[str, float]:
    """PSNR and SSIM of light maps (H, W, 3), encoded and clipped, after a least-squares scale per channel weighted by solid angle.

    `grid`: rows and columns that both are brought to, those of the true map where it is None. `environment_psnr_unscaled` is without
    the scale.
    """
    height, width = grid or truth.shape[:2]
    light, truth = _on_grid(light, height, width), _on_grid(truth, height, width)
    weight = np.sin((np.arange(height) + 0.5) * np.pi / height)[:, None, None]
    fitted = light * fitted_scale(light, truth, weight)
    scaled, plain, true = (encode_srgb(np.clip(image, 0, 1)) for image in (fitted, light, truth))
    figures = {"environment_psnr": psnr(scaled, true), "environment_psnr_unscaled": psnr(plain, true)}
    return figures | ({"environment_ssim": ssim(scaled, true)} if min(height, width) >= SSIM_WINDOW else {})


def _on_grid(light: np.ndarray, height: int, width: int) -> np.ndarray:
    if light.shape[:2] == (height, width):
        return light.astype(np.float64)
    return np.nan_to_num(
        np.asarray(resize(light.astype(np.float64), (height, width), order=1, mode="edge", anti_aliasing=light.shape[0] > height))
    )


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


def squared_chamfer(mesh: Mesh, points: np.ndarray, samples: int = 30_000) -> float:
    """Half the sum of the mean squared distances from mesh to the true points (N, 3) and back, in square scene units."""
    surface, points = _surface_samples(mesh, samples)[0], points.astype(np.float64)
    there, back = KDTree(surface).query(points)[0], KDTree(points).query(surface)[0]
    return float((np.square(there).mean() + np.square(back).mean()) / 2)


def _surface_samples(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Area-uniform points on the triangles and the triangles' normals there, always the same."""
    a, b, c = mesh.vertices.astype(np.float64)[mesh.faces].transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=-1)
    random = np.random.default_rng(0)
    pick = random.choice(len(area), count, p=area / area.sum())
    r, s = np.sqrt(random.random(count))[:, None], random.random(count)[:, None]
    return (1 - r) * a[pick] + r * (1 - s) * b[pick] + r * s * c[pick], cross[pick] / np.maximum(area[pick], 1e-20)[:, None]
