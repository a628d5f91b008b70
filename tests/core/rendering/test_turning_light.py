# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of a sphere whose light turns with the camera, as on a turntable."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.rendering.turning_light import mean_light, mean_over_lights, most_facing_radiance
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.spherical_harmonics import SH_C0, SH_C1
from irgspp.core.shading.environment_lookup import from_light_frame, lookup, texel_directions, to_light_frame


@pytest.fixture(scope="module")
def views(sphere_dataset, camera_ring):
    """Photographs whose light turns with the camera."""
    train = sphere_dataset(camera_ring(10)).train
    first = train[0].camera.to_world[:3, :3]
    return [replace(view, light_rotation=first @ view.camera.to_world[:3, :3].T) for view in train]


@pytest.fixture(scope="module")
def sphere(splat_sphere):
    """Sphere whose radiance is 0.5 + 0.3 x, with x of the direction towards the eye."""
    surfels = splat_sphere(800)
    surfels.sh.zero_()
    surfels.sh[3] = 0.3 / SH_C1
    return Reconstruction(surfels, torch.ones(8, 16, 3), Bound((0, 0, 0), 1.5), np.eye(4))


def test_still_light_changes_nothing(sphere, views):
    still = [replace(view, light_rotation=None) for view in views]
    assert mean_over_lights(sphere, still) is sphere


def test_radiance_is_the_mean_over_the_cameras(sphere, views):
    steady = mean_over_lights(sphere, views).gaussians
    assert not steady.sh[1:].any()
    towards = np.stack([view.camera.centre for view in views])[:, None] - sphere.gaussians.position.T.numpy()
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    cosine = np.maximum((towards * sphere.gaussians.normals().T.numpy()).sum(-1), 1e-3)
    expected = 0.5 + 0.3 * (cosine * towards[..., 0]).sum(0) / cosine.sum(0)
    assert np.allclose(SH_C0 * steady.sh[0, 0].numpy() + 0.5, expected, atol=1e-4)


def test_surfels_are_taken_from_the_camera_they_face(sphere, views):
    radiance, normal = most_facing_radiance(sphere.gaussians, views)
    own = sphere.gaussians.normals().T
    assert torch.allclose(normal.norm(dim=1), torch.ones(len(normal)), atol=1e-5)
    # In the frame of its light, each normal leans towards the first camera, as the camera that sees it does not move there.
    first = torch.from_numpy(views[0].camera.centre).float()
    side = own[:, 2].abs() < 0.3
    assert (normal[side] @ first > 0).all() and not (own[side] @ first > 0).all()
    assert (radiance[:, 0] - 0.5).abs().max() > 0.1


def test_the_mean_light_is_seen_from_everywhere(views):
    light = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))
    rotations = torch.from_numpy(np.stack([view.light_rotation for view in views])).float()
    direction = texel_directions(8, 16).view(-1, 3)
    expected = torch.stack([lookup(light, direction @ one.T) for one in rotations]).mean(0)
    assert torch.allclose(mean_light(light, rotations).view(-1, 3), expected, atol=1e-6)
    assert torch.allclose(mean_light(torch.ones_like(light), rotations), torch.ones_like(light), atol=1e-5)


def test_there_and_back(views):
    rotations = torch.from_numpy(np.stack([view.light_rotation for view in views])).float()
    direction = torch.nn.functional.normalize(torch.randn(len(rotations), 3, generator=torch.Generator().manual_seed(2)), dim=1)
    assert to_light_frame(direction, None) is direction and from_light_frame(direction, None) is direction
    for turn in (rotations, rotations[2]):
        there = to_light_frame(direction, turn)
        assert torch.allclose(from_light_frame(there, turn), direction, atol=1e-6)
        assert not torch.allclose(there, direction, atol=0.1)
    assert torch.allclose(to_light_frame(direction, rotations)[4], rotations[4] @ direction[4], atol=1e-6)
