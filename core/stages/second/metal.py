# SPDX-License-Identifier: GPL-3.0-or-later
"""Thresholds of metal: metallic is optimised as a number in 0..1, decisions need yes or no."""

from __future__ import annotations

from ...scene.gaussians import METALLIC, Gaussians

METAL = 0.5  # metallic of a point, pixel, vertex or Gaussian above which it counts as metal
METAL_ON_AVERAGE = 0.5  # mean metallic above which an object counts as metal


def is_metal_on_average(gaussians: Gaussians) -> bool:
    """Return True where the mean metallic of all surfels is above METAL_ON_AVERAGE."""
    return float(gaussians.materials()[METALLIC].mean()) > METAL_ON_AVERAGE
