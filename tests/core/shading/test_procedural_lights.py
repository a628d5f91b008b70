# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposure and resolution of the procedural light maps."""

import numpy as np
import pytest
import torch
from irgspp.core.io.srgb import luminance
from irgspp.core.shading.environment_lookup import solid_angles, texel_directions
from irgspp.core.shading.procedural_lights import LIGHTS


@pytest.mark.parametrize("name", LIGHTS)
def test_a_white_surface_neither_clips_nor_drowns(name):
    light = LIGHTS[name](32, 64)
    assert light.dtype == np.float32 and light.shape == (32, 64, 3) and (light > 0).all()
    direction = texel_directions(32, 64, torch.float64).numpy()
    power = luminance(light.astype(np.float64)) * solid_angles(32, 64, torch.float64).numpy()[:, None]
    normals = texel_directions(16, 32, torch.float64).numpy().reshape(-1, 3)
    radiance = np.clip(normals @ direction.reshape(-1, 3).T, 0, None) @ power.reshape(-1) / np.pi
    assert 1.1 < radiance.max() < 1.4
    assert radiance.min() > 0.02


@pytest.mark.parametrize("name", LIGHTS)
def test_resolution_changes_nothing_but_detail(name):
    coarse = LIGHTS[name](128, 256).reshape(64, 2, 128, 2, 3).mean((1, 3))
    assert np.abs(coarse - LIGHTS[name](64, 128)).mean() < 0.01
