# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that photographs show directly: what lies behind the object and the table, averaged over views."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.scene.surroundings import Surroundings
from irgspp.core.settings.schema import SecondStageSettings
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.seen_light import DEVIATION, SeenLight, seen_light

SIZE, TABLE = (48, 64), -0.5  # rows and columns; directions below this z meet the table
TEXELS = LightTexels.uniform(12)
SETTINGS = SecondStageSettings()


def sky(direction: np.ndarray) -> np.ndarray:
    """Linear radiance (..., 3) of the distant light in a direction (..., 3)."""
    return 0.3 + 0.2 * direction * [1, 0.5, 0.7]


class Table:
    """Tracer of a table that hides all directions that go down steeply."""

    device = torch.device("cpu")

    def look(self, origin, direction):
        assert origin.shape == direction.shape and origin.dtype == direction.dtype == torch.float32
        return (direction[:, 2] > TABLE).float(), torch.zeros_like(direction)


def photographs(count: int = 8) -> list[View]:
    """Photographs of the sky around an object that fills the middle of each; colours there and on the table are white."""
    views = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        camera = Camera(SIZE[1], SIZE[0], 45.0, 45.0, 32.0, 24.0, look_at((3 * np.cos(angle), 3 * np.sin(angle), 0.8)))
        rays = camera.rays()
        direction = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        alpha = np.zeros(SIZE, np.float32)
        alpha[16:32, 22:42] = 1.0
        hidden = (direction[..., 2] <= TABLE) | (alpha > 0)
        colour = np.where(hidden[..., None], 1.0, encode_srgb(torch.from_numpy(sky(direction))).numpy()).astype(np.float32)
        views.append(View(f"v{i}", camera, Path(f"v{i}.png"), colour, alpha))
    return views


@pytest.fixture
def dataset() -> Dataset:
    one = np.zeros((1, 3), np.float32)
    table = Surroundings(one, np.array([[0, 0, 1]], np.float32), one, np.ones(1, np.float32))
    return Dataset(Path("."), "capture", photographs(), [], Bound((0, 0, 0), 1.0), np.eye(4), surroundings=table)


def test_seen_radiance_is_that_of_the_sky(dataset):
    seen = seen_light(dataset, Table(), SETTINGS)
    assert seen is not None and set(seen.view) == set(range(8))
    np.testing.assert_allclose(seen.radiance, sky(seen.direction), rtol=1e-4)
    assert (seen.direction[:, 2] > TABLE).all() and not seen.saturated.any()
    weight, log_radiance = seen.of_texels(TEXELS)
    middle, _ = TEXELS.directions(1, 0)
    told = weight.numpy() > 0
    assert 60 < told.sum() < 200  # the rest is overhead, or behind the table
    np.testing.assert_allclose(log_radiance.exp().numpy()[told], sky(middle.T)[told], atol=0.06)
    assert (log_radiance.numpy()[~told] == 0).all()


def test_parts_of_a_texel_share_its_weight(dataset):
    seen = seen_light(dataset, Table(), SETTINGS)
    assert seen is not None
    whole, _ = seen.of_texels(TEXELS)
    chosen = whole.numpy() >= np.sort(whole.numpy())[-3]
    parts, _, old = TEXELS.split(chosen)
    weight, _ = seen.of_texels(parts)
    of_parts = np.bincount(old, weight.numpy(), minlength=TEXELS.count)
    assert (of_parts[chosen] <= 1.1 * whole.numpy()[chosen]).all() and of_parts[chosen].sum() > 0
    assert np.allclose(of_parts[~chosen], whole.numpy()[~chosen], rtol=1e-5)


def known(radiance: list[float], saturated: bool = False) -> SeenLight:
    """Four pixels of each of some views in one direction, a radiance for each view."""
    count = 4 * len(radiance)
    colour = np.repeat(np.array(radiance), 4)[:, None] * np.ones(3)
    view = np.repeat(np.arange(len(radiance)), 4)
    return SeenLight(np.tile([[1.0, 0.0, 0.1]], (count, 1)) / np.hypot(1, 0.1), colour, np.full(count, saturated), view)


def test_views_that_differ_tell_less():
    alike, differing = (known(list(values)).of_texels(TEXELS)[0].max() for values in ((0.5, 0.5), (0.25, 1.0)))
    variance = 2 * np.log(2) ** 2  # of two views that differ by a factor of 4
    assert float(differing / alike) == pytest.approx(DEVIATION**2 / (DEVIATION**2 + variance), rel=1e-4)


def test_clipped_pixels_and_few_pixels_tell_nothing():
    assert known([1.0, 1.0], saturated=True).of_texels(TEXELS)[0].max() == 0
    few = known([0.5])
    few = SeenLight(few.direction[:2], few.radiance[:2], few.saturated[:2], few.view[:2])
    assert few.of_texels(TEXELS)[0].max() == 0


def test_nothing_is_seen_without_a_table_or_before_a_turning_light(dataset):
    turning = replace(dataset, train=[replace(view, light_rotation=np.eye(3)) for view in dataset.train])
    unmasked = replace(dataset, train=[replace(view, alpha=None) for view in dataset.train])
    for one in (replace(dataset, surroundings=None), turning, unmasked):
        assert seen_light(one, Table(), SETTINGS) is None
    assert seen_light(dataset, Table(), replace(SETTINGS, surroundings=False)) is None
    covered = [replace(view, alpha=np.ones(SIZE, np.float32)) for view in dataset.train]
    assert seen_light(replace(dataset, train=covered), Table(), SETTINGS) is None
