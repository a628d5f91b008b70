# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays per pixel: one where surfels are larger than the object's pixels, as many as set elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.common.pixel_rays import with_needed_rays

SIDE = 20


def dataset(alpha: np.ndarray | None) -> Dataset:
    camera = Camera(SIDE, SIDE, SIDE, SIDE, SIDE / 2, SIDE / 2, np.eye(4))
    view = View("a", camera, Path("a.png"), np.zeros((SIDE, SIDE, 3), np.float32), alpha)
    return Dataset(Path(), "transforms", [view, replace(view, name="b")], [], Bound((0, 0, 0), 1), np.eye(4))


def settings(surfels: int, *more: str) -> Settings:
    return with_overrides(Settings(), [f"first.gaussians={surfels}", *more])


def test_object_pixels_are_those_of_the_mask() -> None:
    alpha = np.zeros((SIDE, SIDE), np.float32)
    alpha[:5] = 1
    assert dataset(alpha).object_pixels == pytest.approx(5 * SIDE)
    assert dataset(None).object_pixels == SIDE * SIDE


@pytest.mark.parametrize(("surfels", "rays"), [(550, 1), (650, 2)])
def test_surfels_per_pixel_decide(surfels: int, rays: int) -> None:
    assert with_needed_rays(settings(surfels), dataset(None), Silent()).first.subpixels == rays


def test_masks_leave_fewer_pixels() -> None:
    alpha = np.zeros((SIDE, SIDE), np.float32)
    alpha[:5] = 1
    assert with_needed_rays(settings(550), dataset(alpha), Silent()).first.subpixels == 2


@pytest.mark.parametrize(("choice", "rays"), [("on", 1), ("off", 2)])
def test_settings_overrule(choice: str, rays: int) -> None:
    for surfels in (50, 5000):
        assert with_needed_rays(settings(surfels, f"skip.subpixels={choice}"), dataset(None), Silent()).first.subpixels == rays
