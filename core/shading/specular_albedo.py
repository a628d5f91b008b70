# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a white sky the specular lobe sends back: the BRDF's directional albedo as a table, and what it leaves for the body."""

from __future__ import annotations

from functools import cache

import torch

from .brdf import DIELECTRIC_F0, ggx_alpha, sample_visible_normal, schlick, smith_visibility

TABLE = 64
SAMPLES = 512  # of each entry: errors of 2e-4; twice as many take a second more at each start


@cache
def brdf_table() -> torch.Tensor:
    """(TABLE roughness, TABLE n.v, 2): scale and bias of F0 in the specular albedo; from 0 to 1 inclusive."""
    grid = torch.linspace(0, 1, TABLE, dtype=torch.float64).clamp_min(1e-3)
    n_v = grid[None, :, None].expand(TABLE, TABLE, SAMPLES)
    alpha = ggx_alpha(grid)[:, None, None].expand_as(n_v)
    i = torch.arange(SAMPLES, dtype=torch.float64)
    u = torch.stack([(i + 0.5) / SAMPLES, (i * 0.6180339887498949) % 1], -1).expand(*n_v.shape, 2)
    view = torch.stack([(1 - n_v**2).sqrt(), torch.zeros_like(n_v), n_v], -1)
    half = sample_visible_normal(view, alpha, u)
    v_h = (view * half).sum(-1).clamp_min(1e-9)
    n_l = 2 * v_h * half[..., 2] - n_v
    # f cos / p = F G2 / G1, with G1 of the visible-normal density
    g1 = 2 * n_v / (n_v + (alpha**2 + (1 - alpha**2) * n_v**2).sqrt())
    ratio = torch.where(n_l > 0, smith_visibility(n_l.clamp_min(1e-9), n_v, alpha) * 4 * n_l * n_v / g1, 0.0)
    fresnel = schlick(v_h, torch.zeros(1, dtype=torch.float64))
    return torch.stack([(ratio * (1 - fresnel)).mean(-1), (ratio * fresnel).mean(-1)], -1).float()


@cache
def _planes(dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """(1, 2, TABLE, TABLE) the table as an image."""
    return brdf_table().to(device, dtype).permute(2, 0, 1)[None]


def _scale_and_bias(n_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    table = _planes(n_v.dtype, n_v.device)
    grid = torch.stack([n_v, roughness], -1) * 2 - 1
    pair = torch.nn.functional.grid_sample(table, grid[None, None], mode="bilinear", padding_mode="border", align_corners=True)
    return pair[0, :, 0]


def specular_albedo(n_v: torch.Tensor, roughness: torch.Tensor, f0: torch.Tensor) -> torch.Tensor:
    """Directional albedo F0 x scale + bias of the specular lobe; n_v, roughness (P,), f0 (P, 3) -> (P, 3)."""
    scale, bias = _scale_and_bias(n_v, roughness)
    return f0 * scale[:, None] + bias[:, None]


def diffuse_fraction(n_v: torch.Tensor, roughness: torch.Tensor) -> torch.Tensor:
    """1 - E_s: what a dielectric coat lets through to the body, as Blender's Principled has it; n_v, roughness (P,) -> (P,)."""
    scale, bias = _scale_and_bias(n_v, roughness)
    return 1 - (DIELECTRIC_F0 * scale + bias)
