# SPDX-License-Identifier: GPL-3.0-or-later
"""Scale by a marker on the floor of a room's corner, with exact cameras, and markers that must not count."""

import cv2
import numpy as np
import pytest
from irgspp.core.capture.marker import find_marker_scale
from irgspp.core.capture.marker_corners import refine_corners
from irgspp.core.capture.marker_detection import detect_markers
from irgspp.core.capture.sparse_model import PosedPhotograph, SparseModel
from PIL import Image
from room_corner import TEXELS, cameras, take, textures

SIDE = 0.5  # of the marker, units
CORNER = (0.4, 0.45)  # on the floor, units


def with_marker(floor, name, number):
    """The floor's texture with a marker and its white margin."""
    side, margin = int(SIDE * TEXELS), 24
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    marker = cv2.aruco.generateImageMarker(dictionary, number, side)
    row, column = (int(c * TEXELS) for c in CORNER)
    floor = floor.copy()
    floor[row - margin : row + side + margin, column - margin : column + side + margin] = 235
    floor[row : row + side, column : column + side] = np.clip(marker.T, 20, 235)[..., None]  # seen from above, columns x and rows y mirror
    return floor


def exact_model(shots):
    """Sparse model of the true cameras."""
    posed = [PosedPhotograph(s.photograph, s.lens, s.to_world) for s in shots]
    none = np.zeros(0, np.int32)
    return SparseModel(posed, np.zeros((0, 3)), np.zeros((0, 3), np.uint8), none, none, np.zeros((0, 2), np.float32), 0.0, [])


def read(photograph):
    return np.asarray(Image.open(photograph.image))


@pytest.fixture(scope="module", params=[("DICT_5X5_50", 21), ("DICT_APRILTAG_36H11", 5)], ids=["aruco", "apriltag"])
def marked(request, tmp_path_factory):
    *walls, floor = textures()
    turned = {1: 1, 3: 3}
    return request.param, take(tmp_path_factory.mktemp("marked"), cameras(5), [*walls, with_marker(floor, *request.param)], turned)


def test_scale_is_true(marked):
    (name, number), shots = marked
    found = find_marker_scale(exact_model(shots), 0.1, read)
    assert found is not None and found.photographs >= 4 and found.name.endswith(f"id {number}")
    assert found.name.split()[0] in name
    assert abs(found.metres_per_unit * SIDE / 0.1 - 1) < 0.003 and found.error < 0.3


def test_no_marker_is_none(tmp_path):
    shots = take(tmp_path, cameras(3), textures())
    assert find_marker_scale(exact_model(shots), 0.1, read) is None


def test_a_marker_in_two_photographs_is_not_enough(marked):
    assert find_marker_scale(exact_model(marked[1][:2]), 0.1, read) is None


def test_a_marker_that_moves_with_the_camera_does_not_count(marked):
    """It is seen in every photograph, but at no common place."""
    shots = marked[1]
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 3, 60)

    def held(photograph):
        pixels = np.full((photograph.height, photograph.width, 3), 235, np.uint8)
        pixels[90:150, 100:160] = marker[..., None]
        return pixels

    assert [d.number for d in detect_markers(held(shots[0].photograph)[..., 0]) if "4X4" in d.dictionary] == [3]
    assert find_marker_scale(exact_model(shots), 0.1, held) is None


@pytest.mark.parametrize("angle", [0, 17, 45])
def test_corners_of_a_blurred_square_in_linear_light(angle):
    centre, half, turn = np.array([60.3, 61.7]), 25.0, np.radians(angle)
    across = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    truth = centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ across
    y, x = np.mgrid[: 8 * 120, : 8 * 120] / 8 - 7 / 16
    inside = (np.abs((np.stack([x, y], -1) - centre) @ across.T) <= half).all(-1)
    linear = cv2.GaussianBlur(np.where(inside, 0.02, 0.8).reshape(120, 8, 120, 8).mean((1, 3)), (0, 0), 1.2)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    found = refine_corners(np.round(255 * encoded).astype(np.uint8), (truth + 0.8).astype(np.float32))
    assert found is not None and np.abs(found - truth).max() < 0.1
