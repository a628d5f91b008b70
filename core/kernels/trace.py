# SPDX-License-Identifier: GPL-3.0-or-later
"""Differentiable ray tracer of 2D Gaussians (2DGRT): public interface over the numba (CPU) and Warp (GPU) kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch

from ..machine import backend
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .cpu import trace_autograd as cpu_trace
from .cpu.bvh import SurfelTree, flat
from .cpu.trace import transmittance_range
from .cpu.trace_autograd import HitLists

if TYPE_CHECKING:
    from .warp.trace import DeviceLists, DeviceTree

Tree: TypeAlias = "SurfelTree | DeviceTree"
Lists: TypeAlias = "HitLists | DeviceLists"

COLOUR, NORMAL, EXTRA = slice(0, 3), slice(3, 6), 6  # columns of the result of `trace`; distance and opacity follow the extras


def _warp_trace() -> Any:
    """Return the Warp implementation, imported on demand: Warp is an optional dependency."""
    from .warp import trace as tracing

    return tracing


def build_tree(
    position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor, lasting: bool = True
) -> Tree:
    """Build a bounding volume hierarchy over Gaussians; no gradients.

    Args:
        position: (3, N) centres, world.
        quaternion: (4, N) w x y z of any length.
        log_scale: (2, N) logarithms of the two scales.
        opacity: (N,) logits.
        lasting: many rays are traced before the Gaussians move. A GPU's tree is then built on the host, which takes longer and makes a
            better one.

    Returns:
        Tree of the backend that works on the tensors.
    """
    if backend.by_warp(opacity):
        return _warp_trace().DeviceTree.build(position, quaternion, log_scale, opacity, lasting)
    return SurfelTree.build(position, quaternion, log_scale, opacity)


def _check_rays(origin: torch.Tensor, direction: torch.Tensor) -> None:
    """Raise ValueError unless both tensors are (R, 3)."""
    if origin.shape != direction.shape or origin.ndim != 2 or origin.shape[1] != 3:
        shapes = f"{tuple(origin.shape)} and {tuple(direction.shape)}"
        raise ValueError(f"ray origins and directions must have the same shape (R, 3), got {shapes}")


def hit_lists(tree: Tree, origin: torch.Tensor, direction: torch.Tensor) -> Lists:
    """List the Gaussians that rays meet, in exact order, until the transmittance falls to TRANSMITTANCE_MIN.

    Args:
        tree: tree over the Gaussians.
        origin: (R, 3) ray origins, world.
        direction: (R, 3) unit directions.

    Returns:
        Hits of the R rays.

    Raises:
        ValueError: shapes of the rays do not fit.
    """
    _check_rays(origin, direction)
    if not isinstance(tree, SurfelTree):
        return _warp_trace().hit_lists(tree, origin, direction)
    return cpu_trace.hit_lists(tree, origin, direction)


def transmittance(tree: Tree, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Compute the fraction of light that passes along rays; no gradients.

    Args:
        tree: tree over the Gaussians.
        origin: (R, 3) ray origins, world.
        direction: (R, 3) unit directions.

    Returns:
        (R,) transmittance in 0..1, 0 at or below TRANSMITTANCE_MIN.

    Raises:
        ValueError: shapes of the rays do not fit.
    """
    _check_rays(origin, direction)
    if not isinstance(tree, SurfelTree):
        return _warp_trace().transmittance(tree, origin, direction)
    o, d, through = flat(origin), flat(direction), torch.ones(len(origin))
    if tree.depth and len(origin):
        arrays = (o, d, tree.node, tree.child, tree.leaf, tree.depth, through.numpy())
        run_ranges(transmittance_range, even_ranges(len(origin), 4 * thread_count()), *arrays)
    return through


def trace(
    position: torch.Tensor,
    quaternion: torch.Tensor,
    log_scale: torch.Tensor,
    opacity: torch.Tensor,
    sh: torch.Tensor | None,
    extra: torch.Tensor,
    origin: torch.Tensor,
    direction: torch.Tensor,
    tree: Tree,
    degree: int = 3,
) -> torch.Tensor:
    """Composite 2D Gaussians along rays in the exact order of their hits.

    Args:
        position: (3, N) centres, world.
        quaternion: (4, N) w x y z of any length.
        log_scale: (2, N) logarithms of the two scales.
        opacity: (N,) logits.
        sh: (K, 3, N) SH coefficients, K >= (degree + 1)^2; radiance max(0.5 + sum, 0) in the ray's direction. None: colour is 0.
        extra: (E, N) further channels, E >= 0.
        origin: (R, 3) ray origins, world. Hits lie strictly ahead; the caller adds any offset from a surface.
        direction: (R, 3) unit directions.
        tree: built from, or refitted to, exactly these Gaussians.
        degree: SH degree in use, 0..3.

    Returns:
        (R, 8 + E) sums over hits of weight x (colour 3, unit normal 3, extra E, distance 1), not divided by opacity, and last the opacity
        itself. Normals are flipped where the ray meets a surfel from behind. Nearly opaque rays count as opaque: their opacity is 1 and
        their sums are means.

    Raises:
        ValueError: shapes do not fit, or the tree belongs to other Gaussians (on a GPU: to other tensors, or to earlier contents).
    """
    _check_rays(origin, direction)
    if not tree.matches(position, quaternion, log_scale, opacity):
        raise ValueError("the tree belongs to other Gaussians; refit or rebuild it after they change")
    coefficients = 0 if sh is None else (degree + 1) ** 2
    function = cpu_trace.Trace if isinstance(tree, SurfelTree) else _warp_trace().Trace
    return function.apply(position, quaternion, log_scale, opacity, sh, extra, origin, direction, tree, coefficients)


class FrozenGaussians:
    """Renderer of constant Gaussians along rays, without gradients: feature rows are laid out once.

    Args:
        tree: tree over the N Gaussians.
        sh: (K, 3, N) SH coefficients; the degree follows from K = 1, 4, 9 or 16.
        extra: (E, N) further channels.
    """

    def __init__(self, tree: Tree, sh: torch.Tensor, extra: torch.Tensor) -> None:
        self._device = None if isinstance(tree, SurfelTree) else _warp_trace().FrozenGaussians(tree, sh, extra)
        if not isinstance(tree, SurfelTree):
            return
        self._tree, self._extras = tree, len(extra)
        self._coefficients = len(sh)
        self._rows = cpu_trace.pack_rows(sh, extra, self._coefficients)

    def along(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """Composite the Gaussians along rays.

        Args:
            origin: (R, 3) ray origins, world.
            direction: (R, 3) unit directions.

        Returns:
            (R, 8 + E) sums as returned by `trace`.
        """
        if self._device is not None:
            return self._device.along(origin, direction)
        lists = cpu_trace.hit_lists(self._tree, origin, direction)
        return cpu_trace.composite_hits(self._tree, lists, direction, self._rows, self._coefficients, self._extras)[0]


def blend(lists: Lists, values: torch.Tensor, rows: torch.Tensor | None = None) -> torch.Tensor:
    """Sum weight x value over the hits of rays, differentiable in the values.

    Args:
        lists: hits of R rays.
        values: (C, N) channels of the Gaussians.
        rows: (B,) indices of rays in any order; None: all R.

    Returns:
        (B, C) sums, not divided by opacity.
    """
    if not isinstance(lists, HitLists):
        all_rays = torch.arange(lists.rays, device=values.device) if rows is None else rows.detach().to(torch.int64).contiguous()
        return _warp_trace().Blend.apply(values, lists, all_rays)
    ray = np.arange(lists.rays) if rows is None else rows.detach().to(torch.int64).contiguous().numpy()
    return cpu_trace.Blend.apply(values, lists, ray)
