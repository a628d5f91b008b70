# SPDX-License-Identifier: GPL-3.0-or-later
"""Inter-reflections of the first stage: what a floor mirrors of a wall that stands on it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import surfels
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import FirstStageSettings
from irgspp.core.stages.common.training_view import TrainingView, camera_rays
from irgspp.core.stages.first.inter_reflections import InterReflections, traced_from
from irgspp.core.stages.first.material_class import GLOSSY, LOW_GLOSS, METAL
from irgspp.core.stages.first.schedule import RENEWALS, inter_reflections_due

pytestmark = pytest.mark.usefixtures("engine")
WALL = (0.9, 0.2, 0.1)  # radiance
SIZE = 40


def plane(normal, colour):
    """Surfels in a square of side 2 around the origin, across a normal that is an axis."""
    axis = np.argmax(np.abs(normal))
    steps = np.linspace(-1, 1, 81)
    points = np.insert(np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2), axis, 0.0, axis=1)
    count = len(points)
    return surfels(points, np.tile(np.float64(normal), (count, 1)), np.tile(colour, (count, 1)), np.full(count, 0.03), 0.99)


@pytest.fixture
def corner():
    """A floor, and a wall at x = -0.5 that stands on it and radiates WALL."""
    floor, wall = plane((0, 0, 1), (0.0, 0.0, 0.0)), plane((1, 0, 0), WALL)
    wall.position += torch.tensor([-0.5, 0.0, 1.02])[:, None]
    both = floor.joined(wall)
    both.material[4] = -9.0  # no metal: a wall's reflections are 4 % of the light
    return Reconstruction(both, torch.full((8, 16, 3), 1e-3), Bound(np.zeros(3), 2.0), np.eye(4), has_split_sum=True)


@pytest.fixture
def view():
    """A view of the floor from where the wall is seen in it."""
    pose = look_at((1.5, 0.0, 1.0), (0.2, 0.0, 0.0))
    camera = Camera(SIZE, SIZE, 60.0, 60.0, SIZE / 2, SIZE / 2, pose)
    rays, rotation = camera_rays(camera), torch.as_tensor(camera.world_to_cv[:3, :3], dtype=torch.float32)
    world_rays, empty = torch.einsum("ji,jhw->ihw", rotation, rays), torch.zeros(3, SIZE, SIZE)
    return TrainingView(camera, empty, None, empty > 0, rays, world_rays, rotation)


def mirrored_height(view):
    """Height (H, W) at which mirrored rays meet the plane of the wall; NaN where pixels do not show the floor."""
    rays, centre = view.world_rays.numpy(), np.asarray(view.camera.centre)
    distance = -centre[2] / rays[2]
    x, y = centre[0] + distance * rays[0], centre[1] + distance * rays[1]
    onward = (-0.5 - x) / rays[0]
    height, side = -onward * rays[2], y + onward * rays[1]
    inside = (np.abs(x) < 0.9) & (np.abs(y) < 0.9) & (x > -0.3) & (np.abs(side) < 0.9) & (onward > 0)
    return np.where(inside, height, np.nan)


def test_a_floor_mirrors_the_wall_that_stands_on_it(corner, view):
    image = InterReflections(corner, [view])[0].cpu()
    height = mirrored_height(view)
    on_wall, above = np.isfinite(height) & (height > 0.15) & (height < 1.8), np.isfinite(height) & (height > 2.3)
    assert on_wall.sum() > 100
    assert image[0][on_wall].max() < 0.02
    assert torch.allclose(image[1:, on_wall].mean(1), torch.tensor(WALL), atol=0.02)
    if above.any():
        assert image[0][above].min() > 0.98 and image[1:, above].abs().max() < 0.02


def test_a_pixel_that_shows_nothing_is_not_blocked(corner, view):
    apart = replace(corner, gaussians=corner.gaussians.select(torch.arange(81)))  # a row at the floor's edge
    image = InterReflections(apart, [view])[0]
    assert (image[0] == 1).all() and (image[1:] == 0).all()


def test_images_come_from_the_copy_that_a_state_holds(corner, view):
    first = InterReflections(corner, [view])
    again = InterReflections.of_state(first.state(), corner, [view])
    assert torch.equal(first[0], again[0])
    assert torch.equal(first[0], first.along(view))


def test_objects_of_metal_are_traced_unless_the_settings_or_a_turning_light_forbid_it(sphere_dataset, camera_ring):
    dataset, settings = sphere_dataset(camera_ring(3, 32)), FirstStageSettings()
    assert traced_from(settings, METAL, dataset) == METAL.inter_reflections < 1
    assert traced_from(settings, GLOSSY, dataset) == 1 == traced_from(replace(settings, inter_reflections=1.0), METAL, dataset)
    asked = replace(settings, inter_reflections=0.2)
    assert traced_from(asked, GLOSSY, dataset) == 0.2 and traced_from(asked, LOW_GLOSS, dataset) == 1
    turning = replace(dataset, train=[replace(view, light_rotation=np.eye(3)) for view in dataset.train])
    assert traced_from(asked, METAL, turning) == 1


def test_they_are_traced_anew_ten_times_in_a_whole_schedule():
    settings = FirstStageSettings(iterations=1500, inter_reflections=0.4)
    due = [done for done in range(1500) if inter_reflections_due(settings, done)]
    assert due == [600, 750, 900, 1050, 1200, 1350] and 1500 // (due[1] - due[0]) == RENEWALS
    assert not any(inter_reflections_due(replace(settings, inter_reflections=1.0), done) for done in range(1500))
    assert inter_reflections_due(replace(settings, inter_reflections=0.0, iterations=3), 0)
