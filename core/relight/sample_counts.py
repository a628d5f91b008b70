# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of samples per pixel and strategy, and the shift of the sample sets from pixel to pixel."""

from __future__ import annotations

from typing import NamedTuple

import torch

from ..errors import InputError
from ..scene.reconstruction import Reconstruction

# Proportions of the strategies. Unoccluded diffuse light is known exactly (estimate.py), so most samples look for shadows of bright light.
DIELECTRIC, METALLIC = (1, 1, 2), (1, 4, 3)  # metal has no diffuse lobe, which cosine samples are for
HQ, EFFICIENT, EFFICIENT_METALLIC = 512, 32, 16  # totals; a metallic object receives light from few directions and needs fewer
MAX_SAMPLES = 1 << 16
# Inverse powers of the plastic number: multiples modulo 1 fill the unit square evenly (the R2 sequence, Roberts 2018).
R2 = (0.7548776662466927, 0.5698402909980532)
Proportions = tuple[int, int, int]  # of cosine, GGX visible-normal and light-map samples


class SampleCounts(NamedTuple):
    """Numbers of samples per point.

    Attributes:
        cosine: of the cosine about the normal.
        visible_normal: of GGX visible normals.
        light: of the light map.
    """

    cosine: int
    visible_normal: int
    light: int


def sample_counts(samples: str | int, metallic: bool, allocation: Proportions | None = None) -> SampleCounts:
    """Divide a number of samples among the strategies.

    Args:
        samples: "hq", "efficient", or the total number.
        metallic: True for a mostly metallic object.
        allocation: proportions of the strategies; None: those for such an object.

    Raises:
        InputError: when `samples` is anything else.
    """
    named = {"hq": HQ, "efficient": EFFICIENT_METALLIC if metallic else EFFICIENT}
    try:
        total = named[samples] if samples in named else int(samples)
    except ValueError:
        total = 0
    if not 1 <= total <= MAX_SAMPLES:
        raise InputError("--samples", f"{samples} is not a valid number of samples", f"use hq, efficient, or 1 to {MAX_SAMPLES}")
    cosine, visible_normal, light = allocation or (METALLIC if metallic else DIELECTRIC)
    parts = cosine + visible_normal + light
    visible_normal, light = total * visible_normal // parts, total * light // parts
    return SampleCounts(total - visible_normal - light, visible_normal, light)


def pixel_shifts(index: torch.Tensor, width: int) -> torch.Tensor:
    """Return the torus shift of each pixel's sample sets, (P, 2) in [0, 1).

    It is constant per pixel, so that animations do not flicker. Neighbours differ as much as possible, so that the noise is fine-grained
    and a filter removes it: a golden-ratio lattice over the image (Roberts 2018).

    Args:
        index: (P,) flat pixel indices.
        width: width of the image in pixels.
    """
    row, column = (index // width).double(), (index % width).double()
    u = column * R2[0] + row * R2[1]
    v = column * 0.8191725133961645 + row * 0.6710436067037893 + 0.5
    return torch.stack([u - u.floor(), v - v.floor()], -1).float().clamp_max(1 - 1e-7)


def is_mostly_metallic(reconstruction: Reconstruction) -> bool:
    """Return True where the mean metallic of the Gaussians, weighted by opacity and area, exceeds 0.5.

    Light reaches such a surface from few directions, so that fewer samples suffice.
    """
    g = reconstruction.gaussians
    with torch.no_grad():
        weight = g.opacity.sigmoid() * (g.log_scale.sum(0)).exp()  # area
        return float((weight * g.materials()[4]).sum() / weight.sum().clamp_min(1e-30)) > 0.5
