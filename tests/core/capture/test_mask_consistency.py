# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks where stereo finds nothing: on a part of the object that shines like metal and shows the table's colours, and under the object."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture import mask_consistency, object_masks
from irgspp.core.capture.object_masks import cut_out
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import CaptureSettings
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    OBJECT = script("stresses.table_scene").OBJECT

SHINY = 0.2  # x from which the box reflects the table, world units
BELOW = 34  # rows from a shiny pixel to the one whose colour it shows


def on_shiny_part(points):
    """True (...,) for points (..., 3) on the box's shiny part, not on the table or on other things."""
    return (points[..., 0] > SHINY) & (points[..., 0] < 0.5) & (np.abs(points[..., 1]) < 0.4) & (points[..., 2] > 0.02)


@pytest.fixture
def shiny(dense, table_scene, monkeypatch):
    """Views of a box with a shiny part, of which stereo knows nothing, and (H, W) True of each where that part is seen."""
    views, shown = [], []
    for view in table_scene.views:
        rays = view.camera.rays()
        depth = np.where(table_scene.masks[view.name] > 0.5, OBJECT.hit(view.camera.centre, rays), 0)
        part = on_shiny_part(view.camera.centre + np.where(np.isfinite(depth), depth, 0)[..., None] * rays)
        shown.append(part)
        views.append(replace(view, colour=np.where(part[..., None], np.roll(view.colour, -BELOW, 0), view.colour)))
    maps = [replace(one, support=np.where(on_shiny_part(one.points()), 0, one.support).astype(np.uint8)) for one in dense.maps]
    known = replace(dense, maps=maps, points=dense.points.select(~on_shiny_part(dense.points.position)))
    monkeypatch.setattr(object_masks, "find_dense_points", lambda *_: known)
    return views, shown


def test_a_part_that_reflects_the_table_is_not_lost(shiny, table_scene):
    """Without the table's texture in the first cut, .38 of this part is in the masks."""
    views, shown = shiny
    found = cut_out(views, table_scene.points, CaptureSettings(), 0, Silent())
    inside = [mask[part].mean() for mask, part in zip(found.masks, shown, strict=True) if part.sum() > 50]
    assert len(inside) > 6
    assert np.mean(inside) > 0.48


@pytest.mark.parametrize(("overlap", "extra"), [(0.0, 0), (1.1, mask_consistency.MAX_ROUNDS - mask_consistency.MIN_ROUNDS)])
def test_masks_are_cut_until_they_settle(dense, table_scene, heard, monkeypatch, overlap, extra):
    """The extra rounds have a phase each."""
    monkeypatch.setattr(object_masks, "find_dense_points", lambda *_: dense)
    monkeypatch.setattr(mask_consistency, "SETTLED_OVERLAP", overlap)
    watcher, count = heard(), len(table_scene.views)
    assert cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, watcher) is not None
    phases = [steps for name, steps in watcher.phases if name == "cut out the object"]
    assert phases == [(mask_consistency.MIN_ROUNDS + 1) * count] + extra * [count]
