# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick fit: outlines and colours of a sphere, from small images."""

import numpy as np
import pytest
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.first import quick_fit
from irgspp.core.stages.first.quick_fit import quick_renderings


@pytest.fixture
def brief(monkeypatch):
    monkeypatch.setattr(quick_fit, "SURFELS", 400)
    monkeypatch.setattr(quick_fit, "ITERATIONS", 40)


def test_outlines_and_colours_are_the_photographs(brief, sphere_dataset, camera_ring):
    data = sphere_dataset(camera_ring(8))
    found = quick_renderings(data, Settings(), Silent())
    assert len(found) == len(data.train)
    for view, (colour, opacity) in zip(data.train, found, strict=True):
        assert colour.shape == view.colour.shape and opacity.shape == view.alpha.shape
        assert np.minimum(opacity, view.alpha).sum() > 0.8 * np.maximum(opacity, view.alpha).sum()
        inside = view.alpha > 0.99
        assert np.abs(colour - view.colour)[inside].mean() < 0.15
    again = quick_renderings(data, Settings(), Silent())
    assert all(np.array_equal(one[1], other[1]) for one, other in zip(found, again, strict=True))


def test_it_can_be_stopped(brief, sphere_dataset, camera_ring):
    class Stopped(Silent):
        def step(self, done, **metrics):
            self.cancelled = done >= 3

    with pytest.raises(Cancelled):
        quick_renderings(sphere_dataset(camera_ring(8)), Settings(), Stopped())
