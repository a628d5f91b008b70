# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposure gains of a capture: EXIF where it explains the colours, the colours where it does not."""

from dataclasses import replace

import numpy as np
from captured_scene import VIEWS, sparse_model
from irgspp.core.capture.exposures import exposure_gains, stated_log_gains
from irgspp.core.capture.undistortion import undistort_photographs
from irgspp.core.progress.protocol import Silent

TRUE = np.array([1.0, 0.6, 1.4, 0.8, 1.2, 0.9])


def gains_of(model, folder):
    return exposure_gains(model, [one.view for one in undistort_photographs(model, folder, 640, Silent())])


def test_exif_is_taken_where_the_colours_agree(tmp_path):
    model = sparse_model(tmp_path / "photographs", TRUE)
    logs = np.log(TRUE)
    np.testing.assert_allclose(stated_log_gains(model), logs - logs.mean(), atol=1e-9)
    found = gains_of(model, tmp_path)
    assert found.shape == (VIEWS, 3)
    np.testing.assert_allclose(np.log(found).mean(1), logs - logs.mean(), atol=0.02)


def test_one_photograph_without_exif_leaves_the_colours(tmp_path):
    model = sparse_model(tmp_path / "photographs", TRUE)
    bare = replace(model.posed[0], photograph=replace(model.posed[0].photograph, exposure=None))
    model = replace(model, posed=[bare, *model.posed[1:]])
    assert stated_log_gains(model) is None
    found = np.log(gains_of(model, tmp_path)).mean(1)
    assert np.corrcoef(found, np.log(TRUE))[0, 1] > 0.99
    assert np.abs(found - np.log(TRUE) + np.log(TRUE).mean()).max() < 0.12  # less than the truth by the part that may be noise
