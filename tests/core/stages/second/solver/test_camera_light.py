# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that moves with the camera is told from a light that stays."""

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver.camera_light import MIN_CAMERA_LIGHT, camera_light, moves_with_camera
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples

POINTS, VIEWS = 400, 12


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def samples(radiance, saturated=False):
    """Samples of points of a sphere, each seen from in front of it, of radiance `radiance(normal, view)` (K,) times a random albedo."""
    random = np.random.default_rng(0)
    normal = unit(random.normal(size=(POINTS, 3)))
    view = unit(normal.repeat(VIEWS, 0) + 0.8 * unit(random.normal(size=(POINTS * VIEWS, 3))))
    value = radiance(normal.repeat(VIEWS, 0), view) * random.uniform(0.2, 0.8, POINTS).repeat(VIEWS)
    colour = torch.tensor(value, dtype=torch.float32)[:, None].repeat(1, 3)
    place, towards = (torch.tensor(part, dtype=torch.float32) for part in (normal, view))
    point = torch.arange(POINTS).repeat_interleave(VIEWS)
    return MultiViewSamples(place, place, point, towards, colour, torch.full(colour.shape, saturated))


def cosine(normal, view):
    return (normal * view).sum(-1)


def test_a_flash_brightens_what_faces_it_by_the_cosine():
    found = samples(cosine)
    mean = found.sums(found.n_v) / found.lengths
    assert camera_light(found) == pytest.approx(float((1 / mean).mean()), rel=0.05)
    assert moves_with_camera(found)


def test_a_room_with_a_flash_is_told_too():
    assert moves_with_camera(samples(lambda normal, view: 0.5 + cosine(normal, view)))


def highlight(normal, view):
    """A gloss that mirrors one light above, over its diffuse part."""
    mirrored = 2 * cosine(normal, view)[:, None] * normal - view
    return 0.5 + 0.3 * normal[:, 2].clip(0) + 3 * mirrored[:, 2].clip(0) ** 20


@pytest.mark.parametrize("radiance", [lambda normal, view: 1 + normal[:, 2], highlight], ids=["matt", "glossy"])
def test_a_light_that_stays_is_no_light_at_the_camera(radiance):
    assert abs(camera_light(samples(radiance))) < MIN_CAMERA_LIGHT / 2
    assert not moves_with_camera(samples(radiance))


def test_clipped_samples_tell_nothing():
    assert camera_light(samples(cosine, saturated=True)) == 0
