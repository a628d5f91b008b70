# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistortion against the forward distortion formulas: dots drawn where a real lens would project them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.datasets.undistort import pinhole, undistort
from irgspp.core.errors import InputError
from irgspp.core.io.image import DecodedImage

W, H = 160, 120


def lens(distortion, fisheye=False, fx=150.0, fy=148.0, cx=83.0, cy=57.0):
    return Lens("test", W, H, fx, fy, cx, cy, distortion, fisheye)


def distorted_pixel(optics: Lens, x, y):
    """Project the ray (x, y, 1) into the real image by the formulas of OpenCV's documentation, with pixel centres at .5."""
    r2 = x * x + y * y
    if optics.fisheye:
        theta = np.arctan(np.sqrt(r2))
        k1, k2, k3, k4 = optics.distortion
        scale = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8) / np.maximum(np.sqrt(r2), 1e-12)
        u, v = x * scale, y * scale
    else:
        k1, k2, p1, p2, k3 = optics.distortion
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return optics.fx * u + optics.cx, optics.fy * v + optics.cy


LENSES = [
    lens((0.2, 0.0, 0.0, 0.0, 0.0)),
    lens((-0.25, 0.05, 0.0, 0.0, 0.0)),
    lens((0.06, -0.08, -0.002, 0.001, 0.01)),
    lens((-0.1, 0.02, 0.006, -0.004, 0.0)),
    lens((0.03, -0.01, 0.004, -0.001), fisheye=True),
    lens((-0.04, 0.01, 0.0, 0.0), fisheye=True, fx=70.0, fy=70.0),
]


@pytest.mark.parametrize("optics", LENSES, ids=str)
def test_a_dot_lands_on_its_pinhole_projection(optics):
    plain = pinhole(optics)
    rows, columns = np.mgrid[:H, :W] + 0.5
    for target in [(20.2, 15.7), (83.0, 57.0), (140.4, 100.1), (25.0, 104.6), (120.9, 30.3)]:
        x, y = (target[0] - plain.cx) / plain.fx, (target[1] - plain.cy) / plain.fy
        u, v = distorted_pixel(optics, x, y)
        dot = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 1.5**2)).astype(np.float32)
        seen = undistort(DecodedImage(np.repeat(dot[..., None], 3, -1), None), optics).colour[..., 0]
        expected_u, expected_v = distorted_pixel(optics, (columns - plain.cx) / plain.fx, (rows - plain.cy) / plain.fy)
        expected = np.exp(-((expected_u - u) ** 2 + (expected_v - v) ** 2) / (2 * 1.5**2))
        assert np.abs(seen - expected).max() < 0.03  # bicubic; a shift by a tenth of a pixel makes it 0.04
        weight = np.where(seen > 0.5, seen, 0)
        found = (weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()
        assert np.hypot(found[0] - target[0], found[1] - target[1]) < 0.3


@pytest.mark.parametrize("optics", LENSES, ids=str)
def test_no_pixel_comes_from_outside_the_image(optics):
    plain = pinhole(optics)
    assert (plain.cx, plain.cy, plain.size) == (optics.cx, optics.cy, optics.size) and plain.fx >= optics.fx
    rows, columns = np.mgrid[:H, :W] + 0.5
    u, v = distorted_pixel(optics, (columns - plain.cx) / plain.fx, (rows - plain.cy) / plain.fy)
    assert u.min() > -0.02 and v.min() > -0.02 and u.max() < W + 0.02 and v.max() < H + 0.02
    if plain.fx > optics.fx:  # and no more is cut away than needed
        assert min(u.min(), v.min(), W - u.max(), H - v.max()) < 0.6


def test_a_pinhole_is_left_alone():
    image = DecodedImage(np.random.default_rng(0).random((H, W, 3), np.float32), None)
    assert undistort(image, lens(())) is image and pinhole(lens(())) == lens(())


def test_alpha_edges_take_no_colour_from_outside():
    alpha = np.zeros((H, W), np.float32)
    alpha[40:80, 50:110] = 1
    colour = np.where(alpha[..., None] > 0, 0.8, 0.0).astype(np.float32).repeat(3, -1)
    result = undistort(DecodedImage(colour, alpha), LENSES[0])
    assert np.abs(result.colour[result.alpha > 0.05] - 0.8).max() < 1e-3


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.floats(-2, 2)] * 5), st.booleans())
def test_any_coefficients_give_a_full_image_or_an_error(coefficients, fisheye):
    optics = lens(coefficients[:4] if fisheye else coefficients, fisheye)
    try:
        plain = pinhole(optics)
    except InputError:
        return
    rows, columns = np.mgrid[:H, :W] + 0.5
    u, v = distorted_pixel(optics, (columns - plain.cx) / plain.fx, (rows - plain.cy) / plain.fy)
    assert u.min() > -0.5 and v.min() > -0.5 and u.max() < W + 0.5 and v.max() < H + 0.5
    assert optics.fx <= plain.fx <= 10 * optics.fx
