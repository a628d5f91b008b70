# SPDX-License-Identifier: GPL-3.0-or-later
"""Black, white, blurred and near-identical photographs are left out, and no others."""

import cv2
import numpy as np
import pytest
from irgspp.core.capture.usable import Appearance, appearance, read_appearance, same_place, unusable
from PIL import Image

SIZE = (240, 320)
FAR = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(400, 1200)), (0, 0), 1.5)
NEAR = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(400, 1200)), (0, 0), 1.5)


def view(shift=0.0, parallax=0.0, noise=0, gain=1.0):
    """Grey image of a near square in front of a far plane, both textured, as a camera sees it that moved sideways by `parallax` pixels."""

    def moved(layer, by):
        return cv2.warpAffine(layer, np.float32([[1, 0, -by], [0, 1, -40]]), SIZE[::-1])

    image = moved(FAR, shift)
    image[60:180, 80:240] = moved(NEAR, shift + parallax)[60:180, 80:240]
    image = 128 + 40 * image / FAR.std() + np.random.default_rng(noise).normal(size=SIZE)
    return np.clip(gain * image, 0, 255).astype(np.uint8)


def streak(pixels, angle):
    """Kernel of a motion by some pixels."""
    kernel = np.zeros((31, 31), np.float32)
    along = np.array([np.cos(angle), np.sin(angle)]) * pixels / 2
    cv2.line(kernel, *(tuple(int(v) for v in np.round(16 * (15 + s * along))) for s in (-1, 1)), 1.0, 1, cv2.LINE_AA, 4)
    return kernel / kernel.sum()


def left_out(images, lenses=None):
    names = [f"v{i}" for i in range(len(images))]
    out, warnings = unusable(names, lenses or ["lens"] * len(images), [appearance(i) for i in images])
    return {one.name: one.reason for one in out}, warnings


@pytest.fixture(scope="module")
def walk():
    return [view(40 * i, 15 * i, i) for i in range(12)]


def test_sharp_photographs_are_all_kept(walk):
    assert left_out(walk) == ({}, [])


@pytest.mark.parametrize("angle", np.linspace(0, np.pi, 5)[:-1])
def test_motion_blur_in_any_direction(walk, angle):
    images = [*walk[:5], cv2.filter2D(walk[5], -1, streak(9, angle)), *walk[6:]]
    out, warnings = left_out(images)
    assert list(out) == ["v5"] and out["v5"].startswith("blurred: ") and not warnings


def test_defocus_is_found_in_large_photographs_too(walk):
    images = [cv2.resize(np.tile(i, (2, 2)), None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST) for i in walk]
    images[3] = cv2.GaussianBlur(images[3], (0, 0), 8)
    assert list(left_out(images)[0]) == ["v3"]


def test_sharpness_is_compared_within_a_lens(walk):
    soft = [cv2.GaussianBlur(i, (0, 0), 1.2) for i in walk[:6]]
    assert left_out([*soft, *walk[6:]], ["old"] * 6 + ["new"] * 6)[0] == {}


def test_soft_set_is_kept_with_a_warning(walk):
    out, warnings = left_out([cv2.GaussianBlur(i, (0, 0), 4) for i in walk])
    assert not out and "blurred or out of focus as a whole" in warnings[0]


def test_black_white_and_uniform_photographs(walk):
    noise = np.random.default_rng(0).normal(size=SIZE)
    empty = [np.clip(level + noise, 0, 255).astype(np.uint8) for level in (2, 254, 120)]
    out, _ = left_out([*walk, *empty])
    assert [r.split(":")[0] for r in out.values()] == ["black", "white", "uniform"] and list(out) == ["v12", "v13", "v14"]


def test_small_object_before_black_is_seen():
    dark = np.zeros(SIZE, np.uint8)
    dark[100:150, 100:150] = view()[100:150, 100:150]
    assert not appearance(dark).fault


@pytest.mark.parametrize("gain", [1.0, 0.75])
def test_near_identical_photographs_name_their_twin(walk, gain):
    out, _ = left_out([*walk, view(40 * 4 + 1.5, 15 * 4, 99, gain)])
    assert out == {"v12": "near-identical to v4: taken from the same place"}


def test_sharper_twin_is_kept(walk):
    soft = cv2.GaussianBlur(walk[4], (0, 0), 0.8)
    assert left_out([*walk[:4], soft, *walk[5:], view(40 * 4 + 0.5, 15 * 4, 99)])[0] == {
        "v4": "near-identical to v12: taken from the same place"
    }


@pytest.mark.parametrize(("shift", "parallax", "same"), [(0, 0, True), (2, 0, True), (8, 0, False), (0, 1.5, False), (2, -2, False)])
def test_same_place_is_where_nothing_shifts_against_the_background(shift, parallax, same):
    assert same_place(view(), view(shift, parallax, 1)) == same


def test_small_object_on_a_turntable_is_seen_to_move():
    first, second = view(noise=1), view(noise=2)
    for image, shift in ((first, 0), (second, 2)):
        image[90:150, 130:190] = view(500 + shift)[90:150, 130:190]  # 5 % of the picture
    assert not same_place(first, second)


def test_no_texture_is_no_evidence_of_the_same_place():
    flat = np.full(SIZE, 100, np.uint8)
    assert not same_place(flat, flat)


def test_at_least_half_are_kept():
    same = [view(0, 0, i) for i in range(10)]
    out, warnings = left_out(same)
    assert len(out) == 5 and "walk around the object" in warnings[0]


def test_nothing_at_all():
    assert unusable([], [], []) == ([], [])


def test_copies_are_measured_alike(tmp_path, walk):
    large = cv2.resize(walk[0], None, fx=6, fy=6, interpolation=cv2.INTER_CUBIC)
    Image.fromarray(large).convert("RGB").save(tmp_path / "a.jpg", quality=95)
    cv2.imwrite(str(tmp_path / "a.png"), np.repeat(large[..., None], 3, -1).astype(np.uint16) * 257)
    jpeg, deep, true = read_appearance(tmp_path / "a.jpg"), read_appearance(tmp_path / "a.png"), appearance(large)
    assert isinstance(jpeg, Appearance) and jpeg.grey.shape == deep.grey.shape == true.grey.shape == SIZE
    assert np.abs(jpeg.sharpness - true.sharpness).max() < 0.1 and np.abs(deep.sharpness - true.sharpness).max() < 0.02
