# SPDX-License-Identifier: GPL-3.0-or-later
"""EXIF: orientation against Pillow's, focal length and exposure by their definitions, and values of any kind without an error."""

import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irgspp.core.capture.exif import (
    EXIF_IFD,
    EXPOSURE_TIME,
    F_NUMBER,
    FOCAL,
    FOCAL_35,
    HEIGHT,
    ISO,
    ISO_INDEX,
    LENS_MODEL,
    MAKE,
    MODEL,
    ORIENTATION,
    PLANE_UNIT,
    PLANE_X,
    WIDTH,
    Orientation,
    lens_key,
    orientation_of,
    read_shot,
    shot_of,
)
from PIL import Image, ImageOps
from PIL.TiffImagePlugin import IFDRational

TAGS = (ORIENTATION, MAKE, MODEL, EXPOSURE_TIME, F_NUMBER, ISO, ISO_INDEX, FOCAL, FOCAL_35, PLANE_X, PLANE_UNIT, WIDTH, HEIGHT, LENS_MODEL)
numbers = st.one_of(st.integers(), st.floats(), st.builds(IFDRational, st.integers(0, 100), st.integers(0, 3)))
values = st.one_of(st.none(), numbers, st.text(max_size=9), st.binary(max_size=9), st.lists(numbers, max_size=3).map(tuple))


def opened(exif=None):
    data = io.BytesIO()
    Image.new("RGB", (40, 30)).save(data, "JPEG", **({"exif": exif} if exif else {}))
    return Image.open(data)


@given(st.integers(1, 8), st.integers(1, 5), st.integers(1, 5))
def test_orientation_is_that_of_pillow(value, height, width):
    pixels = np.arange(height * width * 3, dtype=np.uint8).reshape(height, width, 3)
    image = Image.fromarray(pixels)
    image.getexif()[ORIENTATION] = value
    assert np.array_equal(orientation_of(value).upright(pixels), np.asarray(ImageOps.exif_transpose(image)))


@given(st.dictionaries(st.sampled_from(TAGS), values), st.integers(1, 9000), st.integers(1, 9000))
def test_any_values_are_read(tags, width, height):
    shot = shot_of(tags, width, height)
    assert shot.focal is None or 0.2 * max(width, height) < shot.focal < 100 * max(width, height)
    assert shot.exposure is None or (math.isfinite(shot.exposure) and shot.exposure > 0)
    assert "\n" not in shot.lens and len(shot.lens) < 300 and shot.orientation.turned in range(4)


@given(st.binary(min_size=0, max_size=200))
def test_damaged_exif_counts_as_absent(data):
    shot = read_shot(opened(b"Exif\0\0" + data))
    assert shot.orientation.turned in range(4)


def test_damage_that_pillow_refuses_is_told(monkeypatch):
    image = opened()
    monkeypatch.setattr(image, "getexif", lambda: {}["damaged"])
    shot = read_shot(image)
    assert shot.orientation == Orientation() and shot.focal is None and "EXIF is damaged" in shot.note


def test_exif_of_a_file(exif):
    shot = {EXPOSURE_TIME: 1 / 60, F_NUMBER: 1.8, ISO: 200, FOCAL: 4.5, FOCAL_35: 28, LENS_MODEL: "wide lens"}
    found = read_shot(opened(exif({MAKE: "Lab", MODEL: "Phone | 5\n", ORIENTATION: 6}, shot)))
    assert found.orientation == Orientation(3) and found.lens == "Lab|Phone 5|wide lens|4.5 mm" and not found.note
    assert found.exposure == pytest.approx(200 / 60 / 1.8**2, rel=1e-3)
    assert found.focal == pytest.approx(28 * 50 / math.hypot(36, 24))  # 40 x 30 pixels have a diagonal of 50


@given(st.integers(500, 8000), st.integers(500, 8000), st.integers(15, 300))
def test_equivalent_focal_length_has_the_angle_of_the_diagonal(width, height, film):
    focal = shot_of({FOCAL_35: film}, width, height).focal
    angle = 2 * math.atan(math.hypot(width, height) / 2 / focal)
    assert angle == pytest.approx(2 * math.atan(math.hypot(36, 24) / 2 / film))
    assert focal == shot_of({FOCAL_35: film}, height, width).focal  # turned


def test_resolution_of_the_sensor_is_more_precise_but_must_agree():
    plane = {FOCAL: 4.532, PLANE_X: 1142.857, PLANE_UNIT: 3, WIDTH: 640, HEIGHT: 480}
    assert shot_of(plane, 640, 480).focal == pytest.approx(517.94, abs=0.01)
    assert shot_of({**plane, FOCAL_35: 28}, 640, 480).focal == pytest.approx(517.94, abs=0.01)
    assert shot_of({**plane, FOCAL_35: 28}, 320, 240).focal == pytest.approx(258.97, abs=0.01)  # reduced by an editor
    assert shot_of({**plane, FOCAL_35: 28}, 480, 640).focal == pytest.approx(517.94, abs=0.01)  # turned by an editor
    assert shot_of({**plane, FOCAL_35: 56}, 640, 480).focal == pytest.approx(56 * 800 / math.hypot(36, 24))  # a crop of half the size
    assert shot_of({FOCAL: 4.532}, 640, 480).focal is None


@pytest.mark.parametrize("missing", [EXPOSURE_TIME, F_NUMBER, ISO])
@pytest.mark.parametrize("value", [None, 0, -1, float("nan"), IFDRational(1, 0), 1e12, "x"])
def test_exposure_needs_all_three(missing, value):
    tags = {EXPOSURE_TIME: 0.01, F_NUMBER: 2, ISO: (100, 0)}
    assert shot_of(tags, 4, 3).exposure == pytest.approx(0.25)
    assert shot_of({**tags, missing: value}, 4, 3).exposure is None


def test_large_iso_is_read_from_its_own_tag():
    tags = {EXPOSURE_TIME: 0.01, F_NUMBER: 2, ISO: 65535}
    assert shot_of(tags, 4, 3).exposure is None
    assert shot_of({**tags, ISO_INDEX: 102400}, 4, 3).exposure == pytest.approx(256)


def test_lens_key_tells_upright_from_lying_copies():
    keys = {lens_key("a", 40, 30), lens_key("a", 30, 40), lens_key("b", 40, 30), lens_key("a", 80, 60), lens_key("", 30, 30)}
    assert len(keys) == 5 and lens_key("a", 40, 30) == "a|40x30|landscape"


def test_exif_directory_is_where_the_tests_write_it(exif):
    assert EXIF_IFD in opened(exif({MAKE: "x"}, {ISO: 100})).getexif()
