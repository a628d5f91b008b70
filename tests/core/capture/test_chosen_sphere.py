# SPDX-License-Identifier: GPL-3.0-or-later
"""A person's sphere about the object: its settings, its checks, the line that offers other things, and masks of what it holds."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture.chosen_sphere import check_points, check_sphere, chosen_sphere, other_things
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.object_masks import cut_out
from irgspp.core.errors import InputError
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import Bound
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import CaptureSettings, Settings
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    scenes = script("stresses.table_scene")


def test_both_or_neither_are_set():
    assert chosen_sphere(CaptureSettings()) is None
    assert chosen_sphere(CaptureSettings(centre=(1, 2, 3), radius=0.5)) == Bound((1.0, 2.0, 3.0), 0.5)
    with pytest.raises(InputError, match=r"capture\.centre: is given without capture\.radius; give both"):
        chosen_sphere(CaptureSettings(centre=(1, 2, 3)))
    with pytest.raises(InputError, match=r"capture\.radius: is given without capture\.centre"):
        chosen_sphere(CaptureSettings(radius=2.0))


@pytest.mark.parametrize("radius", ["0", "-1", "nan"])
def test_a_radius_is_positive(radius):
    with pytest.raises(InputError, match=r"setting capture\.radius"):
        with_overrides(Settings(), ["capture.centre=0,0,0", f"capture.radius={radius}"])


@pytest.mark.parametrize(
    ("sphere", "words"),
    [
        (Bound((0, 0, 60.0), 0.5), "is shown by 0 of 12 photographs; move it"),
        (Bound((0, 0, 0.5), 50.0), "has 12 of 12 cameras inside; make it smaller"),
    ],
)
def test_photographs_show_it_from_outside(table_scene, sphere, words):
    cameras = [view.camera for view in table_scene.views]
    check_sphere(Bound((0, 0, 0.5), 0.6), cameras)
    with pytest.raises(InputError, match=words) as caught:
        check_sphere(sphere, cameras)
    assert len(str(caught.value).splitlines()) == 1


def test_it_holds_points():
    points = [np.zeros((1, 3)), np.ones((2, 3))]
    check_points(Bound((0, 0, 0.4), 0.5), points)
    with pytest.raises(InputError, match="holds no point of the scene"):
        check_points(Bound((0, 0, 0.4), 0.3), points)


def test_an_empty_sphere_above_the_table_is_refused(table_scene, dense, monkeypatch):
    monkeypatch.setattr("irgspp.core.capture.object_masks.find_dense_points", lambda *_: dense)
    with pytest.raises(InputError, match="holds no point of the scene"):
        cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, Silent(), sphere=Bound((-0.8, 0.5, 0.6), 0.2))


def test_the_line_about_other_things_can_be_followed():
    assert other_things([]) == []
    (line,) = other_things([Bound((-0.5, 0.25, 1.0), 0.3), Bound((1, 2, 3), 0.1)])
    assert "2 other things" in line and "X Y Z RADIUS -0.5 0.25 1 0.3, 1 2 3 0.1; " in line and "--sphere" in line
    assert "RADIUS -0.00001234 0 0 0.5;" in other_things([Bound((-1.234e-5, 0, 0), 0.5)])[0]  # -1e-05 would be taken for an option
    assert "and 2 more" in other_things([Bound((0, 0, 0), 1.0)] * 7)[0]


def test_masks_are_of_what_the_sphere_holds(table_scene, dense, table_masks, monkeypatch):
    """The sphere of the other thing, which the first cut left out, turns the masks to it."""
    (sphere,) = table_masks.others
    assert np.allclose(sphere.centre, scenes.CLUTTER.centre, atol=0.1)
    aimed = replace(dense, target=np.array(sphere.centre), reliable=True)
    monkeypatch.setattr("irgspp.core.capture.object_masks.find_dense_points", lambda *_: aimed)
    found = cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, Silent(), sphere=sphere)
    assert found is not None and found.bound == sphere and found.on_object.any()
    truth = scenes.photographed_table((scenes.CLUTTER, scenes.OBJECT)).masks
    hidden = {view.name for view, mask in zip(table_scene.views, found.masks, strict=True) if mask is None}
    assert "view07" in hidden and len(hidden) <= 4  # the box stands before it
    assert dict(found.doubtful) == dict.fromkeys(hidden, "other things hide the object")
    pairs = zip(found.masks, table_scene.views, strict=True)
    assert min(overlap(mask, truth[view.name]) for mask, view in pairs if mask is not None) > 0.85


def test_a_sphere_as_large_as_the_room_takes_no_room_of_voxels(table_scene, dense):
    from irgspp.core.capture.object_region import find_object_region

    cameras = [view.camera for view in table_scene.views]
    region = find_object_region(dense, None, cameras, Bound((0.0, 0.0, 0.5), 3.0))
    assert region is not None and max(region.label.shape) * region.step < 2.5 * 3.0 + 4 * region.step
