# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks where stereo finds nothing: on a part of the object that shines like metal and shows the table's colours, and under the object."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture import object_masks
from irgspp.core.capture.mask_consistency import trusted_silhouettes
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


def test_a_silhouette_is_less_sure_away_from_points_but_not_where_they_enclose_it():
    """The points are two wheels, a body over them, and a hole in it; the silhouette fills the space between the wheels."""
    silhouette, near = np.zeros((40, 60), np.float32), np.zeros((40, 60), np.float32)
    silhouette[5:35, 5:55] = 1.0
    near[5:25, 5:55] = near[25:35, 5:15] = near[25:35, 45:55] = 1.0
    near[10:14, 28:32] = 0.0
    (found,) = trusted_silhouettes([silhouette], [near])
    assert np.all(found[26:35, 16:44] < 0.5)  # between the wheels
    assert np.all(found[5:25, 5:55] == 1.0)  # the body, and the hole that points enclose
    assert np.all(found[silhouette == 0] == 0)


def test_silhouettes_of_an_object_without_points_stay():
    silhouette = np.full((20, 20), 0.95, np.float32)
    few = np.zeros((20, 20), np.float32)
    few[3, 3] = 1.0
    for near in (np.full((20, 20), 0.57, np.float32), few):
        (found,) = trusted_silhouettes([silhouette], [near])
        assert np.all(found > 0.9)
