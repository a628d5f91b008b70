# SPDX-License-Identifier: GPL-3.0-or-later
"""The true distance of two points gives a captured dataset its size."""

import json

import pytest
from irgspp.core.capture.true_size import with_true_size
from irgspp.core.errors import InputError
from irgspp.core.settings.schema import CaptureSettings


@pytest.fixture
def finished(tmp_path):
    (tmp_path / "capture.json").write_text(json.dumps({"format": "irgspp-capture", "status": "done"}))
    return tmp_path


def test_lengths_and_a_sphere_are_scaled_and_scales_multiply(finished):
    settings = CaptureSettings(centre=(1.0, -2.0, 0.5), radius=0.4)
    once = with_true_size(settings, finished, [(0, 0, 0), (0, 3, 4)], 0.5)
    assert once.scale == pytest.approx(0.1)
    assert (*once.centre, once.radius) == pytest.approx((0.1, -0.2, 0.05, 0.04))
    twice = with_true_size(once, finished, [(0.1, 0, 0), (0.3, 0, 0)], 0.1)
    assert twice.scale == pytest.approx(0.05) and twice.radius == pytest.approx(0.02)
    assert with_true_size(CaptureSettings(), finished, [(0, 0, 0), (0, 0, 2)], 1.0).centre is None


@pytest.mark.parametrize("ends", [[(1, 2, 3), (1, 2, 3)], [(0, 0, 0), (float("nan"), 0, 0)]])
def test_one_place_tells_no_size(finished, ends):
    with pytest.raises(InputError, match="no two different points"):
        with_true_size(CaptureSettings(), finished, ends, 1.0)


def test_a_stopped_capture_is_finished_first(finished):
    (finished / "capture.json").write_text(json.dumps({"format": "irgspp-capture", "status": "running"}))
    with pytest.raises(InputError, match="needs a finished capture"):
        with_true_size(CaptureSettings(), finished, [(0, 0, 0), (1, 0, 0)], 1.0)
    with pytest.raises(InputError, match="needs a finished capture"):
        with_true_size(CaptureSettings(), finished / "gone", [(0, 0, 0), (1, 0, 0)], 1.0)
