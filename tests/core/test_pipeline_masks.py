# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase of a job that cuts the masks of a capture again, with stand-ins for the fit and the cut."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from irgspp.core import pipeline
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.phase_results import MASKS
from stand_in_stages import camera

SIZE, ERROR = 40, 2.0


def dataset():
    mask = np.zeros((SIZE, SIZE), np.float32)
    mask[15:25, 15:25] = 1
    views = [View(name, camera(SIZE, SIZE), Path("a.png"), np.zeros((SIZE, SIZE, 3), np.float32), mask, mask_error=ERROR) for name in "abc"]
    return Dataset(Path("photos"), "transforms", views, [], Bound((0, 0, 0), 1.0), np.eye(4))


def cut(monkeypatch, steps):
    """Masks that a job saves whose cuts move the edges by `steps` pixels one after the other, and the masks' areas before each cut."""
    areas, saved = [], {}

    def cut_again(views, rendered, plane, bound):
        assert rendered == [view.name for view in views] and all(view.mask_error == ERROR and not view.cut_by_colours for view in views)
        areas.append(float(views[0].alpha.sum()))
        kernel = np.ones((2 * steps[len(areas) - 1] + 1,) * 2, np.uint8)
        return [replace(view, alpha=cv2.dilate(view.alpha, kernel), mask_error=ERROR / 2, cut_by_colours=True) for view in views]

    monkeypatch.setattr(pipeline, "support_plane_of", lambda surroundings: "plane")
    monkeypatch.setattr(pipeline, "quick_renderings", lambda data, settings, progress: [view.name for view in data.train])
    monkeypatch.setattr(pipeline, "cut_again", cut_again)
    folder = SimpleNamespace(save=saved.__setitem__)
    pipeline.Job(dataset(), folder, Settings(), Silent(), None, None, True, 1024).masks()
    return saved[MASKS], areas


@pytest.mark.parametrize(("steps", "sides"), [([0], [10]), ([2, 0], [10, 14]), ([2, 1, 0], [10, 14, 16]), ([2, 2, 2, 2], [10, 14, 18])])
def test_masks_are_cut_until_their_edges_settle(monkeypatch, steps, sides):
    """At most three times; each cut starts from the last one's masks, and from their first error."""
    saved, areas = cut(monkeypatch, steps)
    assert areas == [side**2 for side in sides]
    alpha, error, by_colours = saved["b"]
    assert alpha.sum() == (sides[-1] + 2 * steps[len(sides) - 1]) ** 2 and error == ERROR / 2 and by_colours
