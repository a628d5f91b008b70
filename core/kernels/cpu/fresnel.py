# SPDX-License-Identifier: GPL-3.0-or-later
"""Fresnel reflectance of a dielectric, F = F0 + (1 - F0) w, for single values and for vectors of 8; see `constants.FRESNEL`."""

from __future__ import annotations

from ..constants import FRESNEL
from .jit import helper

A0, A1, A2, A3, A4 = FRESNEL


@helper
def fresnel_weight(x):
    """Return w at x = 1 - v.h, x >= 0."""
    return x * x * x * ((((x * A4 + A3) * x + A2) * x + A1) * x + A0)


@helper
def fresnel_slope(x):
    """Return dw/dx."""
    return x * x * ((((x * (7 * A4) + 6 * A3) * x + 5 * A2) * x + 4 * A1) * x + 3 * A0)
