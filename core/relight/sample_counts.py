# SPDX-License-Identifier: GPL-3.0-or-later
"""How many samples a pixel gets of each strategy, and how they are shifted from pixel to pixel."""

from __future__ import annotations

import torch

from ..errors import InputError

Counts = tuple[int, int, int]  # cosine, GGX visible normals, light map
# In what proportion. What is not hidden is known without sampling (estimate.py), so most samples look for the shadows of what is bright.
MATT, GLOSSY = (1, 1, 2), (1, 4, 3)  # metal has no diffuse lobe for cosine samples to find
HQ, EFFICIENT, EFFICIENT_GLOSSY = 512, 32, 16  # altogether; light comes to a glossy object from few directions, and fewer do
MOST = 1 << 16


def sample_counts(samples: str | int, glossy: bool) -> Counts:
    """Samples of each strategy for "hq", "efficient" or a number of them altogether. Raises InputError for anything else."""
    named = {"hq": HQ, "efficient": EFFICIENT_GLOSSY if glossy else EFFICIENT}
    try:
        total = named[samples] if samples in named else int(samples)
    except ValueError:
        total = 0
    if not 1 <= total <= MOST:
        raise InputError("--samples", f"{samples} is no number of samples", f"use hq, efficient, or 1 to {MOST}")
    cosine, normal, light = GLOSSY if glossy else MATT
    parts = cosine + normal + light
    by_normal, by_light = total * normal // parts, total * light // parts
    return (total - by_normal - by_light, by_normal, by_light)


def pixel_shifts(index: torch.Tensor, width: int) -> torch.Tensor:
    """(P, 2) in [0, 1) for flat pixel indices (P,): always the same for a pixel, so that nothing flickers; neighbours differ the most,
    so that the noise is fine-grained and a filter removes it (a golden-ratio lattice over the image, Roberts 2018).
    """
    row, column = (index // width).double(), (index % width).double()
    u = column * 0.7548776662466927 + row * 0.5698402909980532
    v = column * 0.8191725133961645 + row * 0.6710436067037893 + 0.5
    return torch.stack([u - u.floor(), v - v.floor()], -1).float().clamp_max(1 - 1e-7)
