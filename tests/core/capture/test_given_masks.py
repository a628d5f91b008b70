# SPDX-License-Identifier: GPL-3.0-or-later
"""Given masks become 8-bit masks of the upright copy, whichever way the tool that made them looked at the photograph."""

import numpy as np
import pytest
from irgspp.core.capture.exif import ORIENTATION, Orientation
from irgspp.core.capture.given_masks import write_given_mask
from PIL import Image
from refused import refused

STORED = np.zeros((60, 80), np.uint8)
STORED[:20, :40] = 255  # the object's corner
TURNED = Orientation(3)


def written(tmp_path, image, size, orientation=TURNED, **options):
    image.save(tmp_path / "mask.png", **options)
    write_given_mask(tmp_path / "mask.png", size, orientation, tmp_path / "out.png")
    made = Image.open(tmp_path / "out.png")
    assert made.mode == "L" and made.size == size
    return np.asarray(made)


def test_mask_of_stored_pixels_is_turned(tmp_path):
    assert np.array_equal(written(tmp_path, Image.fromarray(STORED), (60, 80)), TURNED.upright(STORED))


def test_upright_mask_is_not_turned(tmp_path):
    upright = TURNED.upright(STORED)
    assert np.array_equal(written(tmp_path, Image.fromarray(upright), (60, 80)), upright)


def test_mask_with_its_own_orientation(tmp_path, exif):
    assert np.array_equal(written(tmp_path, Image.fromarray(STORED), (60, 80), exif=exif({ORIENTATION: 6})), TURNED.upright(STORED))


def test_mirrored_photograph(tmp_path):
    mirrored = Orientation(0, True)
    assert np.array_equal(written(tmp_path, Image.fromarray(STORED), (80, 60), mirrored), STORED[:, ::-1])


@pytest.mark.parametrize("scale", [0.5, 2])
def test_mask_of_another_size(tmp_path, scale):
    image = Image.fromarray(STORED).resize((int(80 * scale), int(60 * scale)), Image.Resampling.NEAREST)
    found = written(tmp_path, image, (60, 80)).astype(int)
    assert np.mean(np.abs(found - TURNED.upright(STORED)) > 64) < 0.03


def test_kinds_of_masks(tmp_path):
    labels = Image.fromarray(STORED // 255)
    alpha = Image.merge("LA", [Image.new("L", (80, 60), 255), Image.fromarray(STORED)])
    deep = Image.fromarray(STORED.astype(np.uint16) * 257)
    for image in (labels, alpha, deep, Image.fromarray(STORED > 0), Image.fromarray(STORED).convert("RGB")):
        assert np.array_equal(written(tmp_path, image, (80, 60), Orientation()), STORED)


def test_mask_of_another_shape_is_refused(tmp_path):
    with refused("mask.png", "80x60 pixels, its photograph 90x60"):
        written(tmp_path, Image.fromarray(STORED), (90, 60))
