# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorted images of a capture: their pinhole cameras project points to the dots of the images."""

from dataclasses import replace

import numpy as np
import pytest
from captured_scene import LENS, POINTS, VIEWS, distorted_pixels, sparse_model
from irgspp.core.capture.undistortion import distorted_pixels as places_in_photograph
from irgspp.core.capture.undistortion import undistort_photographs, undistorted_pixels
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.image import read_image
from irgspp.core.progress.protocol import Silent
from PIL import Image


def test_undistorted_places_are_those_of_the_pinhole(tmp_path):
    model = sparse_model(tmp_path / "photographs")
    images = undistort_photographs(model, tmp_path, 640, Silent())
    for one in images:
        pixels = distorted_pixels(model.position, one.posed.to_world)
        np.testing.assert_allclose(undistorted_pixels(pixels, LENS), one.camera.project(model.position)[0], atol=1e-3)


def test_images_are_written_full_size_and_returned_reduced(tmp_path):
    model = sparse_model(tmp_path / "photographs")
    images = undistort_photographs(model, tmp_path, 48, Silent())
    assert [one.view.name for one in images] == [f"p{i}" for i in range(VIEWS)]
    for one in images:
        assert one.image.parent == tmp_path / "images" and read_image(one.image).size == LENS.size
        assert one.view.colour.shape == (36, 48, 3) and (one.view.camera.width, one.view.camera.height) == (48, 36)
        assert one.view.camera.fx == pytest.approx(one.camera.fx / 2)
        full = read_image(one.image).colour
        column, row = np.floor(one.camera.project(model.position)[0]).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < LENS.width) & (row < LENS.height)
        assert inside.sum() > 0.8 * POINTS
        assert np.median(full[row[inside], column[inside]]) > 170  # the dots


def test_given_masks_are_undistorted_too(tmp_path):
    model = sparse_model(tmp_path / "photographs")
    mask = np.zeros((LENS.height, LENS.width), np.uint8)
    mask[:, : LENS.width // 2] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    posed = [replace(model.posed[0], photograph=replace(model.posed[0].photograph, mask=tmp_path / "mask.png")), *model.posed[1:]]
    images = undistort_photographs(replace(model, posed=posed), tmp_path, 48, Silent())
    assert images[1].mask is None
    given = images[0].mask
    assert given.shape == (36, 48) and given[:, :20].min() > 0.99 and given[:, 30:].max() < 0.01


def test_photograph_of_another_size_is_refused(tmp_path):
    model = sparse_model(tmp_path / "photographs")
    Image.new("RGB", (50, 40)).save(model.posed[2].photograph.image)
    with pytest.raises(InputError, match=r"p2\.png: is 50x40 but its camera 96x72"):
        undistort_photographs(model, tmp_path, 48, Silent())


def test_cancelling(tmp_path):
    class Stopped(Silent):
        cancelled = True

    with pytest.raises(Cancelled):
        undistort_photographs(sparse_model(tmp_path / "photographs"), tmp_path, 48, Stopped())


def test_distorted_places_are_those_of_the_photograph(tmp_path):
    model = sparse_model(tmp_path / "photographs")
    for one in model.posed:
        pixels = distorted_pixels(model.position, one.to_world)
        assert places_in_photograph(undistorted_pixels(pixels, LENS), LENS) == pytest.approx(pixels, abs=1e-3)
    plain = replace(LENS, distortion=())
    assert places_in_photograph(pixels, plain) == pytest.approx(pixels)
