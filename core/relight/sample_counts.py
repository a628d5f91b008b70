# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of samples per pixel and strategy, and the shift of the sample sets from pixel to pixel."""

from __future__ import annotations

import torch

from ..errors import InputError

Counts = tuple[int, int, int]  # cosine, GGX visible normals, light map
# Proportions of the strategies. Unoccluded diffuse light is known exactly (estimate.py), so most samples look for shadows of bright light.
MATT, GLOSSY = (1, 1, 2), (1, 4, 3)  # metal has no diffuse lobe, which cosine samples are for
HQ, EFFICIENT, EFFICIENT_GLOSSY = 512, 32, 16  # totals; a glossy object receives light from few directions and needs fewer
MAX_SAMPLES = 1 << 16


def sample_counts(samples: str | int, glossy: bool, allocation: Counts | None = None) -> Counts:
    """Divide a number of samples among the strategies.

    Args:
        samples: "hq", "efficient", or the total number.
        glossy: True for a mostly metallic object.
        allocation: proportions of the strategies; None: those for such an object.

    Returns:
        Numbers of cosine, GGX visible-normal and light-map samples.

    Raises:
        InputError: when `samples` is anything else.
    """
    named = {"hq": HQ, "efficient": EFFICIENT_GLOSSY if glossy else EFFICIENT}
    try:
        total = named[samples] if samples in named else int(samples)
    except ValueError:
        total = 0
    if not 1 <= total <= MAX_SAMPLES:
        raise InputError("--samples", f"{samples} is not a valid number of samples", f"use hq, efficient, or 1 to {MAX_SAMPLES}")
    cosine, ggx, light = allocation or (GLOSSY if glossy else MATT)
    parts = cosine + ggx + light
    ggx_count, light_count = total * ggx // parts, total * light // parts
    return (total - ggx_count - light_count, ggx_count, light_count)


def pixel_shifts(index: torch.Tensor, width: int) -> torch.Tensor:
    """Return the torus shift of each pixel's sample sets, (P, 2) in [0, 1).

    It is constant per pixel, so that animations do not flicker. Neighbours differ as much as possible, so that the noise is fine-grained
    and a filter removes it: a golden-ratio lattice over the image (Roberts 2018).

    Args:
        index: (P,) flat pixel indices.
        width: width of the image in pixels.
    """
    row, column = (index // width).double(), (index % width).double()
    u = column * 0.7548776662466927 + row * 0.5698402909980532
    v = column * 0.8191725133961645 + row * 0.6710436067037893 + 0.5
    return torch.stack([u - u.floor(), v - v.floor()], -1).float().clamp_max(1 - 1e-7)
