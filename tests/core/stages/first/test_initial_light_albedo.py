# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial light and albedo of a sphere with two paints under a smooth light."""

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import ALBEDO
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.spherical_harmonics import sh_radiance
from irgspp.core.shading.environment_lookup import lookup, texel_directions
from irgspp.core.shading.split_sum import diffuse_light
from irgspp.core.stages.first.initial_light_albedo import estimate_light_albedo

DARK, BRIGHT = np.array([0.2, 0.3, 0.4]), np.array([0.6, 0.6, 0.6])
COUNT = 3000


def smooth_light():
    d = texel_directions(16, 32)
    return torch.stack([1.2 + 0.6 * d[..., 2], 1.2 + 0.5 * d[..., 2] + 0.3 * d[..., 0], 1.2 + 0.4 * d[..., 2]], -1)


@pytest.fixture(scope="module")
def bright(splat_sphere):
    """Mask of the bright surfels: patches that no smooth light explains."""
    x, y, z = splat_sphere(COUNT).position.numpy()
    return np.sin(3 * np.arctan2(y, x)) * np.sin(3.5 * z) > 0


def painted(splat_sphere, bright, glossy=False, metallic=0.02):
    light = smooth_light()
    normal = splat_sphere(COUNT).position.T
    irradiance = lookup(diffuse_light(light), normal).numpy()
    g = splat_sphere(COUNT, colour=np.where(bright[:, None], BRIGHT, DARK) * irradiance)
    g.material[4] = torch.logit(torch.tensor(metallic))
    environment = light if glossy else torch.full((64, 128, 3), 0.5)
    return Reconstruction(g, environment, Bound((0, 0, 0), 1.5), np.eye(4), glossy)


def recovered(reconstruction, bright):
    albedo = reconstruction.gaussians.materials()[ALBEDO].T.numpy()
    return np.median(albedo[bright], 0), np.median(albedo[~bright], 0)


def test_two_paints_keep_their_ratio(splat_sphere, bright):
    result = estimate_light_albedo(painted(splat_sphere, bright, metallic=1e-4), seed=0)
    light, dark = recovered(result, bright)
    assert np.allclose(light / dark, BRIGHT / DARK, rtol=0.12)
    assert result.environment.shape == (64, 128, 3) and result.environment.min() > 0
    assert result.environment[:16].mean() > 1.15 * result.environment[-16:].mean()  # it shines from above


def test_albedo_times_light_is_what_was_seen(splat_sphere, bright):
    given = painted(splat_sphere, bright)
    seen = sh_radiance(given.gaussians.sh, given.gaussians.normals()).T
    result = estimate_light_albedo(given, seed=0)
    irradiance = lookup(diffuse_light(result.environment), result.gaussians.normals().T)
    share = 1 - result.gaussians.materials()[4][:, None]
    body = result.gaussians.materials()[ALBEDO].T - (1 - share) * 0.5
    error = (body / share * irradiance - seen).abs() / seen
    assert error.median() < 0.03


def test_known_light_gives_the_albedo_itself(splat_sphere, bright):
    result = estimate_light_albedo(painted(splat_sphere, bright, glossy=True, metallic=1e-4), seed=0)
    light, dark = recovered(result, bright)
    assert np.allclose(light, BRIGHT, atol=5e-3) and np.allclose(dark, DARK, atol=5e-3)
    assert torch.equal(result.environment, smooth_light())


def test_same_seed_same_result(splat_sphere, bright):
    first, second = (estimate_light_albedo(painted(splat_sphere, bright), seed=4) for _ in range(2))
    assert torch.equal(first.gaussians.material, second.gaussians.material) and torch.equal(first.environment, second.environment)
