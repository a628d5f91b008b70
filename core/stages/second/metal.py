# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal: thresholds, since metallic is optimised as a number in 0..1 and decisions need yes or no; and the tint that tells metals apart."""

from __future__ import annotations

import torch

from ...scene.gaussians import METALLIC, Gaussians

METALLIC_THRESHOLD = 0.5  # metallic of a point, pixel, vertex or Gaussian above which it counts as metal
MEAN_METALLIC_THRESHOLD = 0.5  # mean metallic above which an object counts as metal
# Width of a Gaussian kernel in log ratios of channels. With the kernel densities of the search for metal: points of another material that
# became metal, and points of metal that did not, without and with the colours: capture_ogre 80 and 27, 8 and 17; rocker_corner 1 and 13,
# 0 and 8; suzanne_mixed 5 and 1, 5 and 2; a vase with glazed bands 49 and 10, 7 and 4; a basket with a chain 14 and 0, 6 and 1. Widths of
# .1 to .2 give about the same there, and .14 and .3 the same pooled albedo.
TINT_WIDTH = 0.14
DARKEST = 0.01  # albedo below which a channel tells no tint


def is_mostly_metal(gaussians: Gaussians) -> bool:
    """Return True where the mean metallic of all surfels is above MEAN_METALLIC_THRESHOLD."""
    return float(gaussians.materials()[METALLIC].mean()) > MEAN_METALLIC_THRESHOLD


def is_all_metal(gaussians: Gaussians) -> bool:
    """Return True where all surfels are metal.

    Only then the first stage's reflections know light and normals best. A lantern, 60 % metal, gains 4 dB of albedo and 2 dB of light where
    it is solved and refined like an object with metal parts.
    """
    return bool((gaussians.materials()[METALLIC] > METALLIC_THRESHOLD).all())


def tints(log: torch.Tensor) -> torch.Tensor:
    """Return the tints (P, 2) of log albedos (P, 3): log ratios of red and of blue to green."""
    return torch.stack([log[:, 0] - log[:, 1], log[:, 2] - log[:, 1]], 1)
