# SPDX-License-Identifier: GPL-3.0-or-later
"""The second stage of IRGS as a baseline: its start of materials and light. Its BRDF is in core/shading/brdf.py."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from ....scene.gaussians import ALBEDO, METALLIC, ROUGHNESS
from ....scene.reconstruction import Reconstruction

START_ALBEDO, START_ROUGHNESS, START_LIGHT = 0.3, 0.6, 1.5  # of all Gaussians; radiance of all directions
NO_METAL_LOGIT = -12.0  # logit


def irgs_start(start: Reconstruction) -> Reconstruction:
    """Return a reconstruction with constant materials of IRGS' BRDF, none of it metal, and constant light."""
    material = torch.empty_like(start.gaussians.material)
    material[ALBEDO], material[ROUGHNESS] = math.log(START_ALBEDO / (1 - START_ALBEDO)), math.log(START_ROUGHNESS / (1 - START_ROUGHNESS))
    material[METALLIC] = NO_METAL_LOGIT
    light = torch.full_like(start.environment, START_LIGHT)
    return replace(start, gaussians=replace(start.gaussians, material=material), environment=light, brdf="irgs")
