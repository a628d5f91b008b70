# SPDX-License-Identifier: GPL-3.0-or-later
"""How much photographs depend on the light from each direction: against directions that can be named beforehand."""

from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.evaluation.light_dependence import CONSTRAINED, ROWS, constrained_part, light_dependence, on_texels, sphere_mean
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.camera_files import PlacedCamera
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surroundings import Surroundings
from irgspp.core.shading.environment_lookup import texel_directions
from irgspp.core.stages.first.initialization import surfels

DIRECTION = texel_directions(ROWS, 2 * ROWS, torch.float64).numpy()
MATT, MIRROR = (0.8, 0.8, 0.8, 1.0, 0.0), (0.9, 0.9, 0.9, 0.1, 1.0)


def ball(material) -> Reconstruction:
    """Return a unit ball of one material (albedo 3, roughness, metallic)."""
    count = 8000
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    g = surfels(normal, normal, np.full((count, 3), 0.5), np.full(count, np.sqrt(4 * np.pi / count)), 0.99)
    g.material = torch.logit(torch.tensor(material).clamp(1e-6, 1 - 1e-6))[:, None].repeat(1, count)
    return Reconstruction(g, torch.full((8, 16, 3), 0.5), Bound((0, 0, 0), 1.1), np.eye(4))


def seen_from(eye, rotation=None) -> PlacedCamera:
    return PlacedCamera("a", "train", Camera(64, 64, 80.0, 80.0, 32.0, 32.0, look_at(np.array(eye))), Path("a.png"), rotation)


def far() -> list[PlacedCamera]:
    """Return cameras far away on +X, as good as parallel, turned about the view, so that each sees other points."""
    ups = [(0.0, np.sin(angle), np.cos(angle)) for angle in np.linspace(0, 2, 16)]
    cameras = [Camera(64, 64, 1100.0, 1100.0, 32.0, 32.0, look_at(np.array((40.0, 0, 0)), up=np.array(up))) for up in ups]
    return [PlacedCamera("a", "train", camera, Path("a.png")) for camera in cameras]


@pytest.fixture(scope="module")
def matt():
    return ball(MATT)


def test_mean_over_the_sphere_is_one(matt):
    assert sphere_mean(light_dependence(matt, [seen_from((6, 0, 0))])) == pytest.approx(1)


def test_a_matt_ball_depends_on_the_light_behind_the_camera(matt):
    """Of a Lambertian ball seen from afar, the pixels' sum of cosines is (sin t + (pi - t) cos t) at the angle t from the camera."""
    found = light_dependence(matt, far())
    angle = np.arccos(np.clip(DIRECTION[..., 0], -1, 1))
    exact = np.sin(angle) + (np.pi - angle) * np.cos(angle)
    exact /= sphere_mean(exact)
    assert np.abs(found - exact).mean() < 0.1 and np.corrcoef(found.ravel(), exact.ravel())[0, 1] > 0.99
    part = constrained_part(found, ROWS, 2 * ROWS)
    assert not part[angle > np.radians(150)].any() and part[angle < np.radians(110)].all()


def test_a_mirror_depends_on_light_that_a_matt_ball_does_not(matt):
    """A mirroring ball shows nearly the whole sphere; only what lies right behind it is missing."""
    behind = DIRECTION[..., 0] < -0.9
    mirrored, plain = (light_dependence(one, far()) for one in (ball(MIRROR), matt))
    assert mirrored[behind].mean() > 5 * plain[behind].mean() and mirrored[DIRECTION[..., 0] < -0.5].mean() > 0.5


def test_a_table_hides_the_light_below_it(matt):
    step = np.arange(-6, 6, 0.1)
    x, y = (a.ravel() for a in np.meshgrid(step, step))
    table = np.stack([x, y, np.full_like(x, -1.1)], -1).astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (len(x), 1))
    surroundings = Surroundings(table, up, np.full_like(table, 0.5), np.full(len(x), 0.1, np.float32))
    eyes = [seen_from(eye) for eye in ((4, 0, 1), (-4, 0, 1), (0, 4, 1), (0, -4, 1))]
    free, hidden = (light_dependence(matt, eyes, around) for around in (None, surroundings))
    below = DIRECTION[..., 2] < -0.5
    assert free[below].min() > CONSTRAINED > hidden[below].max()
    assert 0.5 < sphere_mean(constrained_part(hidden, 32, 64)) < 0.85 and constrained_part(free, 32, 64).all()


def test_light_that_turns_is_seen_in_its_own_frame(matt):
    half = np.diag([-1.0, -1.0, 1.0])
    still, turned = (light_dependence(matt, [seen_from((6, 0, 0), rotation)]) for rotation in (None, half))
    assert np.allclose(np.roll(still, ROWS, 1), turned, atol=0.02)


def test_photographs_that_show_nothing_constrain_nothing(matt):
    away = Camera(64, 64, 80.0, 80.0, 32.0, 32.0, look_at(np.array((6.0, 0, 0)), (12.0, 0, 0)))
    found = light_dependence(matt, [PlacedCamera("a", "train", away, Path("a.png"))])
    assert (found == 0).all() and not constrained_part(found, 8, 16).any()


def test_maps_of_other_sizes_agree(matt):
    found = light_dependence(matt, [seen_from((6, 0, 0))])
    assert on_texels(found, ROWS, 2 * ROWS) == pytest.approx(found, abs=1e-3)
    assert sphere_mean(on_texels(found, 64, 128)) == pytest.approx(1, abs=0.02)
