# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks of a box on a table against the truth: cut out alone, and with a person's masks."""

import numpy as np
import pytest
from irgspp.core.capture import object_masks
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.object_masks import cut_out
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import CaptureSettings
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    Solid = script("stresses.table_scene").Solid
    photographed_table = script("stresses.table_scene").photographed_table


class Lines(Silent):
    """Progress that keeps its messages."""

    def __init__(self) -> None:
        self.lines, self.phases = [], []

    def message(self, text: str) -> None:
        self.lines.append(text)

    def phase(self, name: str, steps: int) -> None:
        self.phases.append(name)


@pytest.fixture
def known_points(dense, monkeypatch):
    """Dense points of the scene, so that stereo doesn't search them again."""
    monkeypatch.setattr(object_masks, "find_dense_points", lambda *_: dense)


def overlaps(found, scene):
    return np.array([overlap(mask, scene.masks[view.name]) for mask, view in zip(found.masks, scene.views, strict=True)])


def test_masks_are_the_truth(table_masks, table_scene):
    assert overlaps(table_masks, table_scene).min() > 0.93
    assert table_masks.doubtful == []


def test_masks_are_soft_and_the_rest_is_left_out(table_masks):
    values = np.concatenate([mask.ravel() for mask in table_masks.masks])
    assert values.dtype == np.float32
    assert ((values > 0.1) & (values < 0.9)).any()
    assert len(table_masks.others) == 1


def test_bound_and_plane_are_the_objects(table_masks):
    assert np.allclose(table_masks.bound.centre, (0, 0, 0.5), atol=0.1)
    assert table_masks.bound.radius == pytest.approx(0.64, rel=0.35)
    assert table_masks.plane.normal[2] > 0.999


def test_missing_masks_are_completed(table_scene, known_points):
    """Two thirds of the masks are given, all too wide by two pixels; one shows another place."""
    import cv2

    given = {name: cv2.dilate(mask, np.ones((5, 5), np.uint8)) for i, (name, mask) in enumerate(table_scene.masks.items()) if i % 3}
    given["view01"] = np.roll(given["view01"], 60, 1)
    found = cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, Silent(), given=given)
    assert found is not None
    assert overlaps(found, table_scene).min() > 0.9
    assert [name for name, _ in found.doubtful] == ["view01"]


def test_empty_masks_carve_nothing_away(table_scene, known_points):
    given, lines = {name: mask * (i >= 4) for i, (name, mask) in enumerate(table_scene.masks.items())}, Lines()
    found = cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, lines, given=given)
    assert found is not None
    assert overlaps(found, table_scene).min() > 0.9
    assert found.doubtful == []
    assert "masks: the masks of view00, view01, view02, view03 are empty" in lines.lines[0]


def test_uncertain_masks_are_told_and_cost_little(table_scene, known_points):
    """Masks that are widened before they carve still end at the object's edges."""
    lines = Lines()
    found = cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, lines, widening=2)
    assert found is not None
    assert overlaps(found, table_scene).min() > 0.9
    assert any("may be wrong by 2 pixels" in line for line in lines.lines)


def test_a_facade_is_not_cut_out():
    """A wall that fills the pictures, photographed from one side."""
    wall = Solid((-0.5, 0.0, 0.0), (0.5, 9.0, 9.0), (0.5, 0.45, 0.4))
    scene, lines = photographed_table((wall,), count=4, width=120, table=False, target=(0.0, 0.0, 0.0), step=10.0), Lines()
    assert cut_out(scene.views, scene.points, CaptureSettings(), 0, lines) is None
    assert len(lines.lines) >= 1
    assert "used whole" in lines.lines[-1]


def test_off_cuts_nothing_out(table_scene):
    assert cut_out(table_scene.views, table_scene.points, CaptureSettings(masks=False), 0, Silent()) is None


def test_cancelling_stops_the_cut(table_scene, known_points):
    class Stopped(Lines):
        cancelled = True

    progress = Stopped()
    with pytest.raises(Cancelled):
        cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, progress)
    assert progress.phases == ["cut out the object"]
