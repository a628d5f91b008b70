# SPDX-License-Identifier: GPL-3.0-or-later
"""What takes the last noise out of a picture of few samples: the cross-bilateral filter, guided by depth and normals.

Mode `paper` filters the final colour. Mode `demodulated` filters diffuse and specular light apart, each divided by what the surface
reflects of it, so that no texture is blurred, and only as far as there is noise: the estimate's two halves of samples tell how much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.bilateral import bilateral_range
from ..kernels.pool import even_ranges, run_ranges, thread_count
from ..shading.brdf import base_reflectance
from ..shading.split_sum import specular_albedo
from .estimate import Estimate
from .primary import Primary

REACH = 6  # pixels of margin, as far as any filter reaches
BLOCKS = 4  # rows are handed out in this many ranges per thread: the object rarely covers them evenly


@dataclass(frozen=True)
class Filter:
    """Widths: `sigma` in pixels, normals' cosine to the power of 2^`doublings`, depth `epsilon` of the scene radius beside its slope."""

    sigma: float
    doublings: int
    epsilon: float = 0.02

    def spatial(self) -> np.ndarray:
        """(T, T) weights of the neighbours, three sigma to each side."""
        reach = min(REACH, math.ceil(3 * self.sigma))
        bell = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * self.sigma**2))
        return np.outer(bell, bell).astype(np.float32)


PICTURE = DIFFUSE = Filter(2, 7)
SPECULAR = Filter(1.5, 7)
CHANCE = 2.0  # relative error of diffuse light from few samples that agree by chance, times their number


@dataclass(frozen=True)
class Grid:
    """Where pixels lie in planes with a margin around the picture and rows of whole vectors."""

    width: int
    height: int

    @property
    def stride(self) -> int:
        """Floats from row to row."""
        return -(-self.width // 8) * 8 + 2 * REACH

    @property
    def plane(self) -> int:
        """Floats of a plane."""
        return self.stride * (self.height + 2 * REACH)

    def places(self, index: np.ndarray) -> np.ndarray:
        """Flat pixel indices to places in a plane."""
        return (index // self.width + REACH) * self.stride + index % self.width + REACH

    def scatter(self, rows: torch.Tensor, index: np.ndarray) -> np.ndarray:
        """(C, P) values at pixels `index` as C flattened planes, 0 elsewhere."""
        planes = np.zeros((len(rows), self.plane), np.float32)
        planes[:, self.places(index)] = rows.numpy()
        return planes.reshape(-1)


def denoised(estimate: Estimate, surface: Primary, radius: float, mode: str = "demodulated") -> torch.Tensor:
    """(P, 3) reflected light of the surface's points, filtered as `mode` says: "paper", "demodulated" or "off".

    radius: of the scene.
    """
    if mode == "off":
        return estimate.diffuse + estimate.specular
    if mode == "paper":
        return filtered(estimate.diffuse + estimate.specular, surface, radius, PICTURE)
    body = (surface.albedo * (1 - surface.metallic[:, None])).clamp_min(1e-3)
    n_v = (surface.view * surface.normal).sum(-1).clamp(1e-3, 1)
    gloss = specular_albedo(n_v, surface.roughness, base_reflectance(surface.albedo, surface.metallic[:, None])).clamp_min(1e-3)
    chance = (CHANCE / estimate.samples) ** 2
    even = corrected(estimate.diffuse / body, estimate.diffuse_split / body, chance, surface, radius, DIFFUSE)
    sharp = corrected(estimate.specular / gloss, estimate.specular_split / gloss, 0.0, surface, radius, SPECULAR)
    return even * body + sharp * gloss


def corrected(values: torch.Tensor, split: torch.Tensor, chance: float, surface: Primary, radius: float, how: Filter) -> torch.Tensor:
    """Filtered (P, 3) values, drawn back to the unfiltered ones where the filter changes them by more than their noise.

    split: (P, 3), see `Estimate`. chance: squared relative error that is assumed even where both halves agree: they may have missed the
    same lamp. With x the value and f the filtered one, f + k (x - f) errs least with k = 1 - var(x) / E[(x - f)^2] (James and Stein
    1961), both means over the filter's neighbourhood. So edges stay, and with many samples the picture converges.
    """
    smooth = filtered(torch.cat([values, split.square().mean(1, keepdim=True)], 1), surface, radius, how)
    smooth, variance = smooth[:, :3], smooth[:, 3:]
    variance = variance + chance * smooth.square().mean(1, keepdim=True)
    change = filtered((values - smooth).square().mean(1, keepdim=True), surface, radius, how)
    keep = (1 - variance / change.clamp_min(1e-36)).clamp(0, 1)
    return smooth + keep * (values - smooth)


def filtered(values: torch.Tensor, surface: Primary, radius: float, how: Filter) -> torch.Tensor:
    """(P, C) values at the surface's pixels after the filter; every pixel is a mean of its neighbours, with weights that sum to 1."""
    grid = Grid(surface.camera.width, surface.camera.height)
    index = surface.index.numpy()
    planes, guides = grid.scatter(values.T, index), grid.scatter(_guides(surface), index)
    out = np.zeros_like(planes)
    numbers = (how.spatial(), np.float32(how.epsilon * radius), how.doublings)
    rows = even_ranges(grid.height, BLOCKS * thread_count())
    run_ranges(bilateral_range, rows, planes, guides, *numbers, grid.width, REACH, grid.stride, grid.plane, out)
    return torch.from_numpy(out.reshape(-1, grid.plane)[:, grid.places(index)].T.copy())


def _guides(surface: Primary) -> torch.Tensor:
    """(7, P) normal, depth, its slopes to the right and down, coverage."""
    camera = surface.camera
    # The tangent plane n.(x - p) = 0 gives the slopes without the noise of differences.
    across = torch.from_numpy(camera.to_world[:3, 0] / camera.fx).float()
    down = torch.from_numpy(-camera.to_world[:3, 1] / camera.fy).float()
    facing = (surface.normal * surface.ray).sum(-1).clamp_max(-1e-2)
    slopes = [-surface.depth * (surface.normal @ step) / facing for step in (across, down)]
    return torch.cat([surface.normal.T, torch.stack([surface.depth, *slopes, surface.alpha])])
