# SPDX-License-Identifier: GPL-3.0-or-later
"""Directional albedo of the specular lobe: table of the split-sum approximation (Karis 2013), and what remains for the diffuse lobe."""

from __future__ import annotations

from functools import cache

import torch

from ..settings.schema import Brdf
from .brdf import DIELECTRIC_F0, fresnel_weight, ggx_alpha, irgs_lobe, sample_visible_normal, smith_visibility, visible_normal_density

TABLE = 64  # entries along either axis
SAMPLES = 512  # per entry of the table: errors of 2e-4; twice as many would add a second to each start


@cache
def brdf_table(brdf: Brdf) -> torch.Tensor:
    """Return the scale and the bias of F0 in the specular albedo of a BRDF, (TABLE, TABLE, 2).

    Rows are roughness, columns n.v, both from 0 to 1 inclusive. Each entry is the mean over SAMPLES visible normals of
    F G2 / G1 = f cos / p.
    """
    grid = torch.linspace(0, 1, TABLE, dtype=torch.float64).clamp_min(1e-3)
    row = _irgs_row if brdf == "irgs" else _table_row
    return torch.stack([row(grid, roughness) for roughness in grid]).float()  # one row's samples fit into the processor's cache


def _table_row(n_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """Return the scale and the bias of F0, (N, 2), at n.v (N,) for one roughness (), float64."""
    alpha, view, half = _sampled(n_v, roughness)
    n_v = view[..., 2]
    v_h = (view * half).sum(-1).clamp_min(1e-9)
    n_l = 2 * v_h * half[..., 2] - n_v
    # f cos / p = F G2 / G1, with G1 of the visible-normal density
    g1 = 2 * n_v / (n_v + (alpha**2 + (1 - alpha**2) * n_v**2).sqrt())
    ratio = torch.where(n_l > 0, smith_visibility(n_l.clamp_min(1e-9), n_v, alpha) * 4 * n_l * n_v / g1, 0.0)
    fresnel = fresnel_weight(v_h)
    return torch.stack([(ratio * (1 - fresnel)).mean(-1), (ratio * fresnel).mean(-1)], -1)


def _irgs_row(n_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """Return the same of IRGS' BRDF."""
    alpha, view, half = _sampled(n_v, roughness)
    direction = 2 * (view * half).sum(-1, keepdim=True) * half - view
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(len(n_v), 3)
    n_l, value, weight = irgs_lobe(view[:, 0], up, roughness.expand_as(n_v), direction)
    ratio = value * n_l.clamp_min(0) / visible_normal_density(view, direction, alpha).clamp_min(1e-30)
    return torch.stack([(ratio * (1 - weight)).mean(-1), (ratio * weight).mean(-1)], -1)


def _sampled(n_v: torch.Tensor, roughness: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return alpha (N, SAMPLES), view directions and sampled visible normals (N, SAMPLES, 3) at n.v (N,) for one roughness ()."""
    n_v = n_v[:, None].expand(-1, SAMPLES)
    alpha = ggx_alpha(roughness).expand_as(n_v)
    i = torch.arange(SAMPLES, dtype=torch.float64)
    u = torch.stack([(i + 0.5) / SAMPLES, (i * 0.6180339887498949) % 1], -1).expand(*n_v.shape, 2)
    view = torch.stack([(1 - n_v**2).sqrt(), torch.zeros_like(n_v), n_v], -1)
    return alpha, view, sample_visible_normal(view, alpha, u)


@cache
def _planes(brdf: Brdf, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return the table as an image (1, 2, TABLE, TABLE) on a device."""
    return brdf_table(brdf).to(device, dtype).permute(2, 0, 1)[None]


def _scale_and_bias(n_v: torch.Tensor, roughness: torch.Tensor, brdf: Brdf = "principled") -> torch.Tensor:
    """Interpolate the table at n.v (P,) and roughness (P,); return (2, P)."""
    table = _planes(brdf, n_v.dtype, n_v.device)
    grid = torch.stack([n_v, roughness], -1) * 2 - 1
    pair = torch.nn.functional.grid_sample(table, grid[None, None], mode="bilinear", padding_mode="border", align_corners=True)
    return pair[0, :, 0]


def specular_albedo(n_v: torch.Tensor, roughness: torch.Tensor, f0: torch.Tensor, brdf: Brdf = "principled") -> torch.Tensor:
    """Return the directional albedo of the specular lobe, F0 x scale + bias, (P, 3).

    Args:
        n_v: (P,) cosine between normal and view direction, 0..1.
        roughness: (P,) in 0..1.
        f0: (P, 3) reflectance at normal incidence.
        brdf: reflectance model of the lobe.
    """
    scale, bias = _scale_and_bias(n_v, roughness, brdf)
    return f0 * scale[:, None] + bias[:, None]


def diffuse_fraction(n_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """Return 1 - E_s, the fraction of light that a dielectric coat transmits to the diffuse lobe (Blender's Principled BSDF), (P,).

    Args:
        n_v: (P,) cosine between normal and view direction, 0..1.
        roughness: (P,) in 0..1.
    """
    scale, bias = _scale_and_bias(n_v, roughness)
    return 1 - (DIELECTRIC_F0 * scale + bias)
