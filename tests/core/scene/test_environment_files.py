# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment maps read from every type of file, valid and broken."""

import cv2
import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.io.exr import rgb_channels, write_exr
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.scene.environment_files import read_environment
from PIL import Image


@pytest.fixture
def light():
    return np.random.default_rng(0).uniform(0.1, 0.9, (8, 16, 3)).astype(np.float32)


def test_exr_is_exact(light, tmp_path):
    write_exr(tmp_path / "a.exr", rgb_channels(light * 50))
    image, remarks = read_environment(tmp_path / "a.exr")
    np.testing.assert_allclose(image, light * 50)
    assert remarks == []


def test_hdr_keeps_colours_apart(light, tmp_path):
    bright = light * np.float32([30, 2, 7])
    (tmp_path / "ä.HDR").write_bytes(cv2.imencode(".hdr", np.ascontiguousarray(bright[..., ::-1]))[1].tobytes())
    image, remarks = read_environment(tmp_path / "ä.HDR")
    np.testing.assert_allclose(image, bright, atol=0.01 * bright.max())  # shared exponent
    assert image.dtype == np.float32 and remarks == []


def test_png_is_srgb(light, tmp_path):
    Image.fromarray(np.round(encode_srgb(light) * 255).astype(np.uint8)).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_environment(tmp_path / "a.png")[0], light, atol=0.006)


def test_odd_shape_is_reported_and_used(tmp_path):
    write_exr(tmp_path / "square.exr", rgb_channels(np.ones((6, 6, 3), np.float32)))
    image, (remark,) = read_environment(tmp_path / "square.exr")
    assert image.shape == (6, 6, 3) and "6x6" in remark and "square.exr" in remark


def test_bad_texels_are_repaired_and_counted(light, tmp_path):
    light[0, 0, 1], light[1, :2, 0], light[2, 3], light[3, 3, 2] = np.nan, -1, np.inf, 5
    write_exr(tmp_path / "a.exr", rgb_channels(light))
    image, remarks = read_environment(tmp_path / "a.exr")
    assert np.isfinite(image).all() and image.min() >= 0 and (image[2, 3] == 5).all()
    assert image[0, 0, 1] == 0 and not image[1, :2, 0].any()
    assert len(remarks) == 3 and any("2 texels are negative" in r for r in remarks)


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png", "a"])
def test_unreadable_files_are_bad_input(tmp_path, name):
    with pytest.raises(InputError, match=name):
        read_environment(tmp_path / name)
    for data in (b"", b"no image at all", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n\x02\x02"):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=name):
            read_environment(tmp_path / name)
