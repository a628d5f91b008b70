# SPDX-License-Identifier: GPL-3.0-or-later
"""How many samples a pixel gets of each strategy, and how they are shifted from pixel to pixel."""

from __future__ import annotations

import torch

from ..errors import InputError

Counts = tuple[int, int, int]  # cosine, GGX visible normals, light map
HQ: Counts = (256, 128, 128)
EFFICIENT: Counts = (16, 8, 8)
EFFICIENT_GLOSSY: Counts = (8, 4, 4)
MOST = 1 << 16


def sample_counts(samples: str | int, glossy: bool) -> Counts:
    """Samples of each strategy: "hq", "efficient" (fewer where the object is glossy: its light comes from few directions), or a number,
    half of it cosine and a quarter each of the others. Raises InputError for anything else.
    """
    if samples == "hq":
        return HQ
    if samples == "efficient":
        return EFFICIENT_GLOSSY if glossy else EFFICIENT
    try:
        total = int(samples)
    except ValueError:
        total = 0
    if not 1 <= total <= MOST:
        raise InputError("--samples", f"{samples} is no number of samples", f"use hq, efficient, or 1 to {MOST}")
    quarter = total // 4
    return (total - 2 * quarter, quarter, quarter)


def pixel_shifts(index: torch.Tensor, width: int) -> torch.Tensor:
    """(P, 2) in [0, 1) for flat pixel indices (P,): always the same for a pixel, so that nothing flickers; neighbours differ the most,
    so that the noise is fine-grained and a filter removes it (a golden-ratio lattice over the picture, Roberts 2018).
    """
    row, column = (index // width).double(), (index % width).double()
    u = column * 0.7548776662466927 + row * 0.5698402909980532
    v = column * 0.8191725133961645 + row * 0.6710436067037893 + 0.5
    return torch.stack([u - u.floor(), v - v.floor()], -1).float().clamp_max(1 - 1e-7)
