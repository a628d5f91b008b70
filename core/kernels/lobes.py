# SPDX-License-Identifier: GPL-3.0-or-later
"""The specular lobe against a fixed set of directions: what a view of a point makes of each texel of the light.

A point's transport is known in `subs` directions in every texel: how much of the texel it sees (`visible`), and what else shines from
there (`indirect`). Directions run over texels first, then over their subdivisions. The lobe is split where Fresnel adds to F0,

    f_s = F0 D V (1 - p) + D V p,  p = (1 - v.h)^5,

so that both parts are linear in the light and neither knows the albedo.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .cpu.lobes import lobe_rows_range, lobe_sums_range


def _device() -> Any:
    """What does the work on tensors: an option, not installed everywhere."""
    from .warp import lobes

    return lobes


def _subdivisions(fixed: tuple[Any, ...], texels: int) -> int:
    """Directions in each texel; whole vectors of texels, as the kernels don't look where a row ends."""
    subs, left = divmod(fixed[0].shape[1], texels)
    if left or texels % 8:
        raise ValueError(f"{fixed[0].shape[1]} directions are no whole subdivisions of {texels} texels, a multiple of 8")
    return subs


def lobe_rows(point: Any, view: Any, normal: Any, alpha: Any, fixed: tuple[Any, ...], texels: int) -> tuple[Any, Any, Any, Any]:
    """What K views of points make of each texel: numpy's arrays on the CPU, tensors on a device, and the same comes out.

    Args:
        point: (K,) int64. view: (K, 3) unit. normal: (P, 3), alpha: (P,) GGX width.
        fixed: directions (3, D), their solid angles (D,), visible (P, D), indirect (P, 3, D); D = subs x texels. All float32.
        texels: of the light, a multiple of 8. Raises ValueError where it is none.

    Returns:
        The part that F0 scales and the part that Fresnel adds, (K, texels) each, and what both make of the indirect light, (K, 3) each.
    """
    k, subs = len(point), _subdivisions(fixed, texels)
    if isinstance(view, torch.Tensor):
        return _device().lobe_rows(point, view, normal, alpha, fixed, texels)
    rows = np.empty((2, k * texels), np.float32)
    rest = np.empty((2, k, 3), np.float32)
    arrays = (point, view, normal, alpha, *(f.reshape(-1) for f in fixed), *rows, *rest)
    run_ranges(lobe_rows_range, even_ranges(k, 4 * thread_count()), texels, subs, *arrays)
    return rows[0].reshape(k, texels), rows[1].reshape(k, texels), rest[0], rest[1]


def lobe_sums(point: Any, view: Any, normal: Any, alphas: Any, fixed: tuple[Any, ...], light: Any) -> tuple[Any, Any]:
    """Both parts of the lobe over a light (texels, 3) and the indirect light, for J widths: (K, J, 3) each; else as `lobe_rows`."""
    k, texels = len(point), len(light)
    subs = _subdivisions(fixed, texels)
    if isinstance(view, torch.Tensor):
        return _device().lobe_sums(point, view, normal, alphas, fixed, light)
    sums = np.empty((2, k, len(alphas), 3), np.float32)
    planes = np.ascontiguousarray(light.T, np.float32).reshape(-1)
    arrays = (point, view, normal, alphas, *(f.reshape(-1) for f in fixed), planes, *sums)
    run_ranges(lobe_sums_range, even_ranges(k, 4 * thread_count()), texels, subs, *arrays)
    return sums[0], sums[1]
