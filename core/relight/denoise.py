# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoiser of relit images of few samples: a cross-bilateral filter guided by depth and normals.

Mode `paper` filters the final colour. Mode `demodulated` filters diffuse and specular light separately, each divided by its albedo, so
that texture is not blurred, and only as far as there is noise, which the two halves of the samples tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..kernels.cpu.bilateral import correct_range, mean_range, smooth_range, weigh_range
from ..kernels.cpu.reflected_light import demodulate_range, remodulate_range
from ..machine.backend import by_warp, send
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..shading.brdf import base_reflectance
from ..shading.split_sum import specular_albedo
from .estimate import Estimate
from .primary_hits import PrimaryHits

FILTER_MARGIN = 6  # pixels of margin: the largest radius of a filter
RANGES_PER_THREAD = 4  # ranges of rows per thread: the object rarely covers the rows evenly


@dataclass(frozen=True)
class Filter:
    """Widths of the cross-bilateral filter.

    Attributes:
        sigma: spatial standard deviation, pixels.
        doublings: binary logarithm of the power of the cosine between normals.
        epsilon: tolerated difference of depth, as a fraction of the scene radius, in addition to the slope of the surface.
    """

    sigma: float
    doublings: int
    epsilon: float = 0.02

    def spatial(self) -> np.ndarray:
        """Return the spatial weights (T, T) of the neighbours, three sigma to each side."""
        reach = min(FILTER_MARGIN, math.ceil(3 * self.sigma))
        bell = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * self.sigma**2))
        return np.outer(bell, bell).astype(np.float32)


IMAGE = DIFFUSE = Filter(2, 7)
SPECULAR = Filter(1.5, 7)
LEAST_ALBEDO = 1e-3  # of a lobe, by which its light is divided
CHANCE_ERROR = 2.0  # assumed relative error of the diffuse light times the number of samples: few samples may agree by chance


@dataclass(frozen=True)
class Grid:
    """Memory layout of padded image planes: a margin around the image and rows of whole vectors.

    Attributes:
        width: width of the image in pixels.
        height: height of the image in pixels.
    """

    width: int
    height: int

    @property
    def stride(self) -> int:
        """Return the number of floats from row to row."""
        return -(-self.width // 8) * 8 + 2 * FILTER_MARGIN

    @property
    def plane(self) -> int:
        """Return the number of floats of a plane."""
        return self.stride * (self.height + 2 * FILTER_MARGIN)

    def places(self, index: np.ndarray) -> np.ndarray:
        """Return the positions in a plane, (P,), of flat pixel indices (P,)."""
        return (index // self.width + FILTER_MARGIN) * self.stride + index % self.width + FILTER_MARGIN


class Guides:
    """Guide layers of a surface and the filter weights that follow from them, which do not depend on the light.

    Args:
        surface: covered pixels of a view.
        radius: scene radius, world units.
        keep_weights: keep the weights from one filter call to the next, 0.6 kB per pixel.

    Attributes:
        diffuse: (P, 3) albedo of the diffuse lobe, by which its light is divided before it is filtered.
        specular: (P, 3) the same of the specular lobe.
    """

    def __init__(self, surface: PrimaryHits, radius: float, keep_weights: bool = False) -> None:
        self._grid, self._radius, self._keep_weights = Grid(surface.camera.width, surface.camera.height), radius, keep_weights
        self.diffuse, self.specular = _lobe_albedos(surface)
        self._weights: dict[Filter, np.ndarray] = {}
        self._index = surface.index if by_warp(surface.index) else None  # on a GPU
        if self._index is not None:
            self._values = _guides(surface).T.contiguous()
            return
        index = surface.index.numpy()
        self._places = self._grid.places(index)
        self._groups = np.unique(self._places - index % surface.camera.width % 8)  # first pixels of groups of 8
        self._planes = self._scattered(_guides(surface))

    @property
    def size(self) -> int:
        """Return the bytes of the kept weights."""
        return sum(weights.nbytes for weights in self._weights.values())

    @staticmethod
    def kept_size(surface: PrimaryHits) -> int:
        """Estimate the bytes of the weights that a surface would keep."""
        return len(surface.index) * 2 * sum(len(bilateral.spatial()) ** 2 for bilateral in (DIFFUSE, SPECULAR))

    def filtered(self, values: torch.Tensor, bilateral: Filter) -> torch.Tensor:
        """Filter values at the surface's pixels: every pixel becomes a weighted mean of its neighbours, with weights that sum to 1.

        Args:
            values: (P, C) per pixel.
            bilateral: widths of the filter.

        Returns:
            (P, C) filtered values.
        """
        if self._index is not None:
            return self._on_device(self._index, values, bilateral)
        planes = self._scattered(values.T)
        out = np.empty_like(planes)
        run_ranges(mean_range, self._ranges, *self._arguments(bilateral), planes, out)
        return self._gathered(out)

    def corrected(self, light: torch.Tensor, split: torch.Tensor, albedo: torch.Tensor, chance: float, bilateral: Filter) -> torch.Tensor:
        """Return the denoised light of a lobe, (P, 3).

        Args:
            light: see `corrected_reference`, which defines the result.
            split: see there.
            albedo: see there.
            chance: see there.
            bilateral: widths of the filter.
        """
        if self._index is not None:
            return corrected_reference(light, split, albedo, chance, self, bilateral)
        points, plane = even_ranges(len(light), thread_count()), self._grid.plane
        at, arguments = (albedo.contiguous().numpy(), self._places, plane), self._arguments(bilateral)
        planes, smooth = np.zeros(4 * plane, np.float32), np.empty(4 * plane, np.float32)
        out, change, result = np.empty(3 * plane, np.float32), np.zeros(plane, np.float32), np.empty((len(light), 3), np.float32)
        run_ranges(demodulate_range, points, light.contiguous().numpy(), split.contiguous().numpy(), *at, planes)
        run_ranges(smooth_range, self._ranges, *arguments, planes, smooth, change)
        run_ranges(correct_range, self._ranges, *arguments, planes, smooth, change, np.float32(chance), out)
        run_ranges(remodulate_range, points, out, *at, result)
        return torch.from_numpy(result)

    @property
    def _ranges(self) -> list[tuple[int, int]]:
        """Return the ranges of groups that threads work on."""
        return even_ranges(len(self._groups), RANGES_PER_THREAD * thread_count())

    def _arguments(self, bilateral: Filter) -> tuple[Any, ...]:
        """Return the arguments that all kernels begin with; the weights are computed where they are to be kept and are not yet."""
        spatial, size = bilateral.spatial(), (self._grid.stride, self._grid.plane)
        guided = (self._planes, spatial, np.float32(bilateral.epsilon * self._radius), bilateral.doublings)
        if self._keep_weights and bilateral not in self._weights:
            self._weights[bilateral] = np.empty(len(self._groups) * spatial.size * 8, np.uint16)
            run_ranges(weigh_range, self._ranges, self._groups, *guided, *size, self._weights[bilateral])
        return self._groups, self._weights.get(bilateral, np.empty(0, np.uint16)), *guided, *size

    def _gathered(self, planes: np.ndarray) -> torch.Tensor:
        """Return the values (P, C) of flattened planes at the surface's pixels."""
        return torch.from_numpy(planes.reshape(-1, self._grid.plane)[:, self._places].T.copy())

    def _on_device(self, index: torch.Tensor, values: torch.Tensor, bilateral: Filter) -> torch.Tensor:
        """Filter values (P, C) at flat pixel indices (P,) by the Warp kernel."""
        from ..kernels.warp.bilateral import filtered  # an optional dependency

        spatial = send(bilateral.spatial(), values.device)
        image = (index, self._grid.width, self._grid.height)
        return filtered(*image, self._values, spatial, bilateral.epsilon * self._radius, bilateral.doublings, values.contiguous())

    def _scattered(self, rows: torch.Tensor) -> np.ndarray:
        """Scatter C rows of values at the pixels, (C, P), to C flattened planes, 0 elsewhere."""
        planes = np.zeros((len(rows), self._grid.plane), np.float32)
        planes[:, self._places] = rows.numpy()
        return planes.reshape(-1)


def denoised(estimate: Estimate, guides: Guides, mode: str = "demodulated") -> torch.Tensor:
    """Denoise the reflected light of a surface.

    Args:
        estimate: diffuse and specular light of P points of a surface, with the differences of their two halves of samples.
        guides: guide layers and albedos of the surface.
        mode: "paper", "demodulated" or "off".

    Returns:
        (P, 3) linear radiance.
    """
    if mode == "off":
        return estimate.diffuse + estimate.specular
    if mode == "paper":
        return guides.filtered(estimate.diffuse + estimate.specular, IMAGE)
    chance = (CHANCE_ERROR / estimate.samples) ** 2
    diffuse = guides.corrected(estimate.diffuse, estimate.diffuse_split, guides.diffuse, chance, DIFFUSE)
    return diffuse + guides.corrected(estimate.specular, estimate.specular_split, guides.specular, 0.0, SPECULAR)


def _lobe_albedos(surface: PrimaryHits) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the albedo of the diffuse lobe and that of the specular lobe, (P, 3) each, not 0."""
    diffuse = surface.albedo * (1 - surface.metallic[:, None])
    n_v = (surface.view * surface.normal).sum(-1).clamp(1e-3, 1)
    specular = specular_albedo(n_v, surface.roughness, base_reflectance(surface.albedo, surface.metallic[:, None]))
    return diffuse.clamp_min(LEAST_ALBEDO), specular.clamp_min(LEAST_ALBEDO)


def corrected_reference(
    light: torch.Tensor, split: torch.Tensor, albedo: torch.Tensor, chance: float, guides: Guides, bilateral: Filter
) -> torch.Tensor:
    """Filter light over albedo, and blend what was there back in where the filter changed it by more than its noise.

    With x the value and f the filtered one, f + k (x - f) has the least error for k = 1 - var(x) / E[(x - f)^2] (James and Stein 1961),
    both as means over the filter's neighbourhood. Therefore edges remain, and with many samples the image converges.

    This is the definition by PyTorch operations: on a GPU, and as the reference of the CPU's kernels (`Guides.corrected`).

    Args:
        light: (P, 3) noisy light of a lobe.
        split: (P, 3) difference of its two halves of samples, see `Estimate`.
        albedo: (P, 3) of the lobe, not 0.
        chance: squared relative error to assume even where both halves agree, since both may have missed the same lamp.
        guides: guide layers of the surface.
        bilateral: widths of the filter.

    Returns:
        (P, 3) denoised light.
    """
    values, variance = light / albedo, (split / albedo).square().mean(1, keepdim=True)
    smooth = guides.filtered(torch.cat([values, variance], 1), bilateral)
    smooth, variance = smooth[:, :3], smooth[:, 3:]
    variance = variance + chance * smooth.square().mean(1, keepdim=True)
    change = guides.filtered((values - smooth).square().mean(1, keepdim=True), bilateral)
    keep = (1 - variance / change.clamp_min(1e-36)).clamp(0, 1)
    return (smooth + keep * (values - smooth)) * albedo


def _guides(surface: PrimaryHits) -> torch.Tensor:
    """Return the guide layers (7, P): normal, depth, its slopes to the right and down, coverage."""
    camera = surface.camera
    # The tangent plane n.(x - p) = 0 gives the slopes without the noise of differences.
    steps = (camera.to_world[:3, 0] / camera.fx, -camera.to_world[:3, 1] / camera.fy)
    across, down = (send(step.astype(np.float32), surface.depth.device) for step in steps)
    facing = (surface.normal * surface.ray).sum(-1).clamp_max(-1e-2)
    slopes = [-surface.depth * (surface.normal @ step) / facing for step in (across, down)]
    return torch.cat([surface.normal.T, torch.stack([surface.depth, *slopes, surface.alpha])])
