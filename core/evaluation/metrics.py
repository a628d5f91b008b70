# SPDX-License-Identifier: GPL-3.0-or-later
"""Metrics of images, normals, light maps and meshes as functions of arrays; protocols.py says which pixels and views go into them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
import trimesh
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree
from skimage.transform import resize

from ..io.srgb import encode_srgb
from ..scene.mesh import Mesh

SSIM_WINDOW = 11  # pixels that an image must have along each side
SEED = 0  # of the surface samples: the same mesh gets the same values again


def format_metric(value: float) -> str:
    """Return a metric as text: counts (int) without decimals, values below 1e-3 with a power of ten, others with four decimals."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.2e}" if 0 < abs(value) < 1e-3 else f"{value:.4f}"


def on_black(rgba: np.ndarray) -> np.ndarray:
    """Convert linear premultiplied RGBA (H, W, 4) to sRGB-encoded colour (H, W, 3) in 0..1, times alpha."""
    rgba = np.nan_to_num(rgba.astype(np.float64), nan=0.0, posinf=1.0, neginf=0.0)
    alpha = np.clip(rgba[..., 3:], 0, 1)
    straight = np.where(alpha > 1e-6, rgba[..., :3] / np.maximum(alpha, 1e-6), 0)
    return encode_srgb(np.clip(straight, 0, 1)) * alpha


def psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB for a peak of 1, at most 100.

    Args:
        a: image (H, W, 3) or any other array.
        b: image of the same shape.
        mask: (H, W) bool, the pixels that count; all where it is None.
    """
    error = np.square(a.astype(np.float64) - b)
    return float(-10 * np.log10(max((error if mask is None else error[mask]).mean(), 1e-10)))


def ssim(a: np.ndarray, b: np.ndarray, window: int = SSIM_WINDOW) -> float:
    """Return the structural similarity of two images (Wang et al. 2004), with a Gaussian window of sigma 1.5 pixels.

    With the usual window of 11 the mean is over pixels whose window lies inside the image, as in Wang et al.; with another one it is
    over all pixels, images mirrored at their edges, as kornia computes it. scikit-image ties the Gaussian window to 11 pixels, so it
    could replace the first case alone.

    Args:
        a: image (H, W, 3) in 0..1.
        b: image (H, W, 3) in 0..1.
        window: pixels along a side at which the Gaussian is cut off, odd.
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
    """Return the angles (H, W) in degrees between two normal maps.

    Args:
        normals: (H, W, 3), estimated; a pixel without a normal (length 0) gets 90 degrees.
        truth: (H, W, 3), true.
    """
    n, t = normals.astype(np.float64), truth.astype(np.float64)
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(n, t), axis=-1), (n * t).sum(-1)))
    return np.where(np.linalg.norm(n, axis=-1) > 1e-6, angle, 90.0)


def fitted_scale(values: np.ndarray, truth: np.ndarray, weight: np.ndarray | float = 1.0) -> np.ndarray:
    """Return the factors (C,) that bring the values closest to the truth, by weighted least squares per channel.

    Args:
        values: (..., C), estimated.
        truth: (..., C), true.
        weight: of the squared errors; broadcasts to (..., C).
    """
    axes = tuple(range(values.ndim - 1))
    values, truth = values.astype(np.float64), truth.astype(np.float64)
    return (weight * truth * values).sum(axes) / np.maximum((weight * values * values).sum(axes), 1e-12)


def albedo_scale(
    albedos: Sequence[np.ndarray],
    truths: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    fit: Literal["median", "least squares"] = "median",
) -> np.ndarray:
    """Return the albedo's factor per channel (3,) over the masked pixels of all views; 1 where no pixel is masked.

    Args:
        albedos: of each view, (H, W, 3) linear, estimated.
        truths: of each view, (H, W, 3) linear, true.
        masks: of each view, (H, W) bool.
        fit: median of truth / albedo, or least squares.
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
    """Return the pixels (H, W) bool that lie at least 2 pixels (of a square) inside a mask (H, W).

    Everything outside the image counts as inside the mask.
    """
    return cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def cosine_distance(normals: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Return the mean of 1 - cosine between two normal maps; a pixel without a normal counts 1.

    Args:
        normals: (H, W, 3), estimated.
        truth: (H, W, 3), true.
        mask: (H, W) bool, the pixels that count.
    """
    n, t = (v[mask].astype(np.float64) / (np.linalg.norm(v[mask], axis=-1, keepdims=True) + 1e-6) for v in (normals, truth))
    return float(1 - (n * t).sum(-1).mean())


def environment_metrics(
    light: np.ndarray, truth: np.ndarray, grid: tuple[int, int] | None = None, part: np.ndarray | None = None
) -> dict[str, float]:
    """Return PSNR and SSIM of a light map, encoded and clipped, after a least-squares scale per channel weighted by solid angle.

    `environment_psnr_unscaled` is without the scale; `environment_ssim` is missing where the maps are smaller than its window.
    `environment_psnr_constrained` is over a part of the sphere alone, after a scale that is fitted there.

    Args:
        light: lat-long map (H, W, 3), linear, estimated.
        truth: lat-long map (H', W', 3), linear, true.
        grid: rows and columns that both maps are resized to; those of the true map where it is None.
        part: bool of the size of the grid, the directions that the photographs constrain; None or none of them: no such metric.
    """
    height, width = grid or truth.shape[:2]
    light, truth = on_grid(light, height, width), on_grid(truth, height, width)
    scaled, plain, true = (encode_srgb(np.clip(image, 0, 1)) for image in (light * light_scale(light, truth), light, truth))
    values = {"environment_psnr": psnr(scaled, true), "environment_psnr_unscaled": psnr(plain, true)}
    if part is not None and part.any():
        constrained = encode_srgb(np.clip(light * light_scale(light, truth, part), 0, 1))
        values["environment_psnr_constrained"] = psnr(constrained, true, part)
    return values | ({"environment_ssim": ssim(scaled, true)} if min(height, width) >= SSIM_WINDOW else {})


def light_scale(light: np.ndarray, truth: np.ndarray, part: np.ndarray | None = None) -> np.ndarray:
    """Return the factors (3,) that bring a light map closest to the true one, by least squares weighted by solid angle.

    Args:
        light: lat-long map (H, W, 3), linear, estimated.
        truth: lat-long map (H, W, 3), linear, true.
        part: (H, W) bool, the directions that count; all where it is None.
    """
    height = len(light)
    weight = np.sin((np.arange(height) + 0.5) * np.pi / height)[:, None, None]
    return fitted_scale(light, truth, weight if part is None else weight * part[..., None])


def on_grid(light: np.ndarray, height: int, width: int) -> np.ndarray:
    """Resize a light map (H, W, 3) to (height, width, 3)."""
    if light.shape[:2] == (height, width):
        return light.astype(np.float64)
    return np.nan_to_num(
        np.asarray(resize(light.astype(np.float64), (height, width), order=1, mode="edge", anti_aliasing=light.shape[0] > height))
    )


def mesh_distances(mesh: Mesh, points: np.ndarray, normals: np.ndarray, near: float = 0.1, samples: int = 300_000) -> dict[str, float]:
    """Return point-to-plane distances, in scene units, between a mesh and samples of the true surface that the cameras saw.

    `mesh_completeness` is truth to mesh; `mesh_accuracy` mesh to truth, of mesh points within `near` of the seen surface;
    `mesh_stray` the fraction of mesh points beyond; `mesh_chamfer` the mean of the first two.

    Args:
        mesh: reconstructed.
        points: (N, 3) of the true surface.
        normals: (N, 3), unit.
        near: largest distance of a mesh point that counts as part of the seen surface.
        samples: points drawn on the mesh.
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
    """Return half the sum of the mean squared distances from mesh to truth and from truth to mesh, in square scene units.

    Args:
        mesh: reconstructed.
        points: (N, 3) of the true surface.
        samples: points drawn on the mesh.
    """
    surface, points = _surface_samples(mesh, samples)[0], points.astype(np.float64)
    to_mesh, to_truth = KDTree(surface).query(points)[0], KDTree(points).query(surface)[0]
    return float((np.square(to_mesh).mean() + np.square(to_truth).mean()) / 2)


def _surface_samples(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw points (count, 3) uniformly by area and return them with the unit normals (count, 3) of their triangles."""
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, triangle, *_ = trimesh.sample.sample_surface(body, count, seed=SEED)
    return np.asarray(points), np.asarray(body.face_normals[triangle])
