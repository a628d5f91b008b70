# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of the ray tracer of 2D Gaussians: every ray against every Gaussian."""

from __future__ import annotations

import torch

from ...scene.spherical_harmonics import sh_basis
from ..constants import ALPHA_MAX, ALPHA_MIN, BEHIND, GRAZING
from .compositing import weights
from .rotations import rotation_matrix


def trace_reference(
    position: torch.Tensor,
    quaternion: torch.Tensor,
    log_scale: torch.Tensor,
    opacity: torch.Tensor,
    sh: torch.Tensor | None,
    extra: torch.Tensor,
    origin: torch.Tensor,
    direction: torch.Tensor,
    degree: int = 3,
) -> torch.Tensor:
    """Composite 2D Gaussians along rays by definition, every ray against every Gaussian, in float64.

    Args:
        position: (3, N) centres, world.
        quaternion: (4, N) w x y z of any length.
        log_scale: (2, N) logarithms of the two scales.
        opacity: (N,) logits.
        sh: (K, 3, N) SH coefficients, K >= (degree + 1)^2, or None.
        extra: (E, N) further channels.
        origin: (R, 3) ray origins, world.
        direction: (R, 3) unit directions.
        degree: SH degree in use, 0..3.

    Returns:
        (R, 8 + E) sums, as returned by `core.kernels.trace.trace`.
    """
    axes, scale, alpha0 = rotation_matrix(quaternion), log_scale.exp(), opacity.sigmoid()
    cosine = direction @ axes[:, 2]
    square = cosine**2 > GRAZING
    centre = position - origin[:, :, None]  # (R, 3, N)
    t = (centre * axes[:, 2]).sum(1) / torch.where(square, cosine, 1.0)
    hit = direction[:, :, None] * t[:, None] - centre
    rho = ((hit * axes[:, 0]).sum(1) / scale[0]) ** 2 + ((hit * axes[:, 1]).sum(1) / scale[1]) ** 2
    alpha = (alpha0 * torch.exp(-0.5 * rho)).clamp_max(ALPHA_MAX)
    alpha = torch.where(square & (t > 0) & (alpha >= ALPHA_MIN), alpha, 0.0)
    order = torch.argsort(t, dim=1, stable=True)
    weight = torch.zeros_like(alpha).scatter(1, order, weights(alpha.gather(1, order)))

    colour = torch.zeros(len(origin), 3, dtype=weight.dtype)
    if sh is not None:
        shown = torch.einsum("kr,kcn->rcn", sh_basis(direction.T, degree), sh[: (degree + 1) ** 2]) + 0.5
        colour = (shown.clamp_min(0) * weight[:, None]).sum(2)
    normal = torch.where(cosine > BEHIND, -weight, weight) @ axes[:, 2].T
    parts = [colour, normal, weight @ extra.T, (weight * t).sum(1, keepdim=True), weight.sum(1, keepdim=True)]
    return torch.cat(parts, 1)
