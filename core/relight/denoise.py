# SPDX-License-Identifier: GPL-3.0-or-later
"""What takes the last noise out of an image of few samples: the cross-bilateral filter, guided by depth and normals.

Mode `paper` filters the final colour. Mode `demodulated` filters diffuse and specular light apart, each divided by what the surface
reflects of it, so that no texture is blurred, and only as far as there is noise: the estimate's two halves of samples tell how much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.cpu.bilateral import bilateral_range, mean_range, weigh_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..shading.brdf import base_reflectance
from ..shading.split_sum import specular_albedo
from .estimate import Estimate
from .primary_hits import PrimaryHits

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


IMAGE = DIFFUSE = Filter(2, 7)
SPECULAR = Filter(1.5, 7)
CHANCE = 2.0  # relative error of diffuse light from few samples that agree by chance, times their number


@dataclass(frozen=True)
class Grid:
    """Where pixels lie in planes with a margin around the image and rows of whole vectors."""

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


class Guides:
    """A surface as filters see it, and their weights, which no light changes.

    Args:
        surface: whose pixels. radius: of the scene. kept: whether weights are kept from filter to filter, 1.2 kB a pixel.
    """

    def __init__(self, surface: PrimaryHits, radius: float, kept: bool = False) -> None:
        self._grid, self._radius, self._kept = Grid(surface.camera.width, surface.camera.height), radius, kept
        self._weights: dict[Filter, np.ndarray] = {}
        self._index = surface.index if by_warp(surface.index) else None  # on a device
        if self._index is not None:
            self._values = _guides(surface).T.contiguous()
            return
        index = surface.index.numpy()
        self._places = self._grid.places(index)
        self._groups = np.unique(self._places - index % surface.camera.width % 8)  # of 8 pixels
        self._planes = self._scattered(_guides(surface))

    @property
    def size(self) -> int:
        """Bytes of kept weights."""
        return sum(weights.nbytes for weights in self._weights.values())

    @staticmethod
    def kept_size(surface: PrimaryHits) -> int:
        """Bytes that they come to, about."""
        return len(surface.index) * 4 * sum(len(how.spatial()) ** 2 for how in (DIFFUSE, SPECULAR))

    def filtered(self, values: torch.Tensor, how: Filter) -> torch.Tensor:
        """(P, C) values at the surface's pixels; every pixel becomes a mean of its neighbours, with weights that sum to 1."""
        if self._index is not None:
            return self._on_device(self._index, values, how)
        planes, spatial = self._scattered(values.T), how.spatial()
        out, size = np.empty_like(planes), (self._grid.stride, self._grid.plane)
        parts = even_ranges(len(self._groups), BLOCKS * thread_count())
        guided = (self._planes, spatial, np.float32(how.epsilon * self._radius), how.doublings)
        if not self._kept:
            run_ranges(bilateral_range, parts, self._groups, *guided, planes, *size, out)
        else:
            if how not in self._weights:
                self._weights[how] = np.empty(len(self._groups) * spatial.size * 8, np.float32)
                run_ranges(weigh_range, parts, self._groups, *guided, *size, self._weights[how])
            run_ranges(mean_range, parts, self._groups, self._weights[how], planes, len(spatial) // 2, *size, out)
        return torch.from_numpy(out.reshape(-1, self._grid.plane)[:, self._places].T.copy())

    def _on_device(self, index: torch.Tensor, values: torch.Tensor, how: Filter) -> torch.Tensor:
        from ..kernels.warp.bilateral import filtered  # an option, not installed everywhere

        spatial = torch.from_numpy(how.spatial()).to(values.device)
        image = (index, self._grid.width, self._grid.height)
        return filtered(*image, self._values, spatial, how.epsilon * self._radius, how.doublings, values.contiguous())

    def _scattered(self, rows: torch.Tensor) -> np.ndarray:
        """(C, P) values as C flattened planes, 0 elsewhere."""
        planes = np.zeros((len(rows), self._grid.plane), np.float32)
        planes[:, self._places] = rows.numpy()
        return planes.reshape(-1)


def denoised(estimate: Estimate, surface: PrimaryHits, guides: Guides, mode: str = "demodulated") -> torch.Tensor:
    """(P, 3) reflected light of the surface's points, filtered as `mode` says: "paper", "demodulated" or "off"."""
    if mode == "off":
        return estimate.diffuse + estimate.specular
    if mode == "paper":
        return guides.filtered(estimate.diffuse + estimate.specular, IMAGE)
    body = (surface.albedo * (1 - surface.metallic[:, None])).clamp_min(1e-3)
    n_v = (surface.view * surface.normal).sum(-1).clamp(1e-3, 1)
    gloss = specular_albedo(n_v, surface.roughness, base_reflectance(surface.albedo, surface.metallic[:, None])).clamp_min(1e-3)
    chance = (CHANCE / estimate.samples) ** 2
    even = corrected(estimate.diffuse / body, estimate.diffuse_split / body, chance, guides, DIFFUSE)
    sharp = corrected(estimate.specular / gloss, estimate.specular_split / gloss, 0.0, guides, SPECULAR)
    return even * body + sharp * gloss


def corrected(values: torch.Tensor, split: torch.Tensor, chance: float | torch.Tensor, guides: Guides, how: Filter) -> torch.Tensor:
    """Filtered (P, 3) values, drawn back to the unfiltered ones where the filter changes them by more than their noise.

    split: (P, 3), see `Estimate`. chance: squared relative error that is assumed even where both halves agree: they may have missed the
    same lamp. With x the value and f the filtered one, f + k (x - f) errs least with k = 1 - var(x) / E[(x - f)^2] (James and Stein
    1961), both means over the filter's neighbourhood. So edges stay, and with many samples the image converges.
    """
    smooth = guides.filtered(torch.cat([values, split.square().mean(1, keepdim=True)], 1), how)
    smooth, variance = smooth[:, :3], smooth[:, 3:]
    variance = variance + chance * smooth.square().mean(1, keepdim=True)
    change = guides.filtered((values - smooth).square().mean(1, keepdim=True), how)
    keep = (1 - variance / change.clamp_min(1e-36)).clamp(0, 1)
    return smooth + keep * (values - smooth)


def _guides(surface: PrimaryHits) -> torch.Tensor:
    """(7, P) normal, depth, its slopes to the right and down, coverage."""
    camera = surface.camera
    # The tangent plane n.(x - p) = 0 gives the slopes without the noise of differences.
    across = torch.from_numpy(camera.to_world[:3, 0] / camera.fx).to(surface.depth)
    down = torch.from_numpy(-camera.to_world[:3, 1] / camera.fy).to(surface.depth)
    facing = (surface.normal * surface.ray).sum(-1).clamp_max(-1e-2)
    slopes = [-surface.depth * (surface.normal @ step) / facing for step in (across, down)]
    return torch.cat([surface.normal.T, torch.stack([surface.depth, *slopes, surface.alpha])])
