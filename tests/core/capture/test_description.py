# SPDX-License-Identifier: GPL-3.0-or-later
from types import SimpleNamespace

import numpy as np
import pytest
from irgspp.core.capture.description import CaptureResult, with_object_shown
from irgspp.core.capture.object_masks import HIDDEN, ObjectMasks
from irgspp.core.scene.dataset import Bound


def result(masked, sphere=None):
    """A capture of four photographs, of which some have masks."""
    images = [SimpleNamespace(view=SimpleNamespace(name=f"v{i}")) for i in range(4)]
    masks = [np.ones((2, 2), np.float32) if one else None for one in masked]
    found = ObjectMasks(masks, None, Bound((0.0, 0.0, 0.0), 1.0), [("v0", "look at it"), ("v3", HIDDEN)], None, np.zeros(0, bool))
    model = SimpleNamespace(subset=lambda kept: kept)
    return CaptureResult(model, images, found, np.ones((4, 3)), np.eye(4), False, [], sphere=sphere)


@pytest.mark.parametrize("sphere", [None, Bound((0.0, 0.0, 0.0), 1.0)])
def test_photographs_without_a_mask_are_left_out(sphere):
    shown = with_object_shown(result((True, True, False, False), sphere))
    assert shown.model == [0, 1] and [one.view.name for one in shown.images] == ["v0", "v1"] and len(shown.gains) == 2
    assert [(one.name, one.reason) for one in shown.left_out] == [("v2", "does not show the object"), ("v3", HIDDEN)]
    assert shown.found.doubtful == [("v0", "look at it")] and all(mask is not None for mask in shown.masks)


def test_where_most_lack_a_mask_all_stay_unless_a_sphere_chose_the_object():
    few = (True, False, False, False)
    assert len(with_object_shown(result(few)).images) == 4
    assert len(with_object_shown(result(few, Bound((0.0, 0.0, 0.0), 1.0))).images) == 1
