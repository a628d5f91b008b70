# SPDX-License-Identifier: GPL-3.0-or-later
"""Thresholds of metal: metallic is optimised as a number in 0..1, decisions need yes or no."""

from __future__ import annotations

from ...scene.gaussians import METALLIC, Gaussians

METALLIC_THRESHOLD = 0.5  # metallic of a point, pixel, vertex or Gaussian above which it counts as metal
MEAN_METALLIC_THRESHOLD = 0.5  # mean metallic above which an object counts as metal


def is_mostly_metal(gaussians: Gaussians) -> bool:
    """Return True where the mean metallic of all surfels is above MEAN_METALLIC_THRESHOLD."""
    return float(gaussians.materials()[METALLIC].mean()) > MEAN_METALLIC_THRESHOLD
