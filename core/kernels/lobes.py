# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular lobe over the texels of a light: public interface for numpy arrays (CPU) and tensors (GPU).

For P points the transport is precomputed in a fixed set of D directions, `subs` in every texel: how much of the texel is visible
and the radiance that arrives from other surfaces (`TracedDirections`). Directions run over texels first, then over their
subdivisions. The lobe is split where Fresnel adds to F0,

    f_s = F0 D V (1 - w) + D V w,  w the Fresnel weight (`constants.FRESNEL`),

so that both parts are linear in the light and independent of the albedo.

A direction stands for a part of the sphere. Where the lobe is narrow against it (`constants.NARROW`), the lobe's mean over
`constants.PER_STRATUM` directions in it counts: few directions would miss a highlight or weigh it too much, and a rougher surface would fit
better.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch

from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .cpu.lobes import lobe_rows_range, lobe_sums_range

MAX_WIDTHS = 63  # of lobes that are integrated at a time: bits of an integer


class TracedDirections(NamedTuple):
    """Precomputed transport from D directions to P points, as float32 arrays (CPU) or tensors (GPU).

    Attributes:
        direction: (3, D) unit; texels run fastest.
        solid_angle: (D,) steradians.
        visibility: (P, D) transmittance, 0..1.
        indirect_radiance: (P, 3, D) linear radiance of other surfaces.
    """

    direction: Any
    solid_angle: Any
    visibility: Any
    indirect_radiance: Any


def _warp_lobes() -> Any:
    """Return the Warp implementation, imported on demand: Warp is an optional dependency."""
    from .warp import lobes

    return lobes


def _subdivisions(traced: TracedDirections, texels: int) -> int:
    """Return the number of directions per texel; raise ValueError unless texels come in whole vectors of 8."""
    subs, left = divmod(traced.direction.shape[1], texels)
    if left or texels % 8:
        raise ValueError(f"{traced.direction.shape[1]} directions do not divide evenly into {texels} texels, which must be a multiple of 8")
    return subs


def lobe_rows(
    point: Any, view: Any, normal: Any, alpha: Any, traced: TracedDirections, strata: Any, texels: int
) -> tuple[Any, Any, Any, Any]:
    """Compute the weight of every texel of the light in K views of points.

    Args:
        point: (K,) int64 point of each view.
        view: (K, 3) unit, towards the eye.
        normal: (P, 3) unit normals of the points.
        alpha: (P,) GGX widths of the points.
        traced: transport from D = subs x texels directions to P points.
        strata: (D, 3, PER_STRATUM) float32 unit directions that are spread over what each direction stands for.
        texels: number of texels of the light, a multiple of 8.

    Returns:
        The part of the lobe that F0 scales and the part that Fresnel adds, (K, texels) each; and both parts applied to the indirect
        light, (K, 3) each. Arrays or tensors, as the inputs are.

    Raises:
        ValueError: D is no multiple of `texels`, or `texels` no multiple of 8.
    """
    k, subs = len(point), _subdivisions(traced, texels)
    if isinstance(view, torch.Tensor):
        return _warp_lobes().lobe_rows(point, view, normal, alpha, traced, strata, texels)
    rows = np.empty((2, k * texels), np.float32)
    rest = np.empty((2, k, 3), np.float32)
    arrays = (point, view, normal, alpha, *(f.reshape(-1) for f in (*traced, strata)), *rows, *rest)
    run_ranges(lobe_rows_range, even_ranges(k, 4 * thread_count()), texels, subs, *arrays)
    return rows[0].reshape(k, texels), rows[1].reshape(k, texels), rest[0], rest[1]


def lobe_sums(point: Any, view: Any, normal: Any, alphas: Any, traced: TracedDirections, strata: Any, light: Any) -> tuple[Any, Any]:
    """Integrate both parts of the lobe over a light and the indirect light, for J GGX widths.

    Args:
        point: (K,) int64 point of each view.
        view: (K, 3) unit, towards the eye.
        normal: (P, 3) unit normals of the points.
        alphas: (J,) GGX widths, the same for all views; 63 at most.
        traced: as for `lobe_rows`.
        strata: as for `lobe_rows`.
        light: (texels, 3) linear radiance, `texels` a multiple of 8.

    Returns:
        The part that F0 scales and the part that Fresnel adds, (K, J, 3) each.

    Raises:
        ValueError: D is no multiple of the texels, these no multiple of 8, or there are too many widths.
    """
    if len(alphas) > MAX_WIDTHS:
        raise ValueError(f"{len(alphas)} widths of a lobe, at most {MAX_WIDTHS} are possible")
    k, texels = len(point), len(light)
    subs = _subdivisions(traced, texels)
    if isinstance(view, torch.Tensor):
        return _warp_lobes().lobe_sums(point, view, normal, alphas, traced, strata, light)
    sums = np.empty((2, k, len(alphas), 3), np.float32)
    planes = np.ascontiguousarray(light.T, np.float32).reshape(-1)
    arrays = (point, view, normal, alphas, *(f.reshape(-1) for f in (*traced, strata)), planes, *sums)
    run_ranges(lobe_sums_range, even_ranges(k, 4 * thread_count()), texels, subs, *arrays)
    return sums[0], sums[1]
