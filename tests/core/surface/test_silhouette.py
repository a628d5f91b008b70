# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouette offset of meshes that are too small or too large by a known fraction of a pixel."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from irgspp.core.surface.silhouette import silhouette_offset

SIZE, DISTANCE = 96, 4.0


def mask_of(camera, samples=4):
    """Return the fraction (H, W) of each pixel that the unit sphere covers."""
    rays = camera.resized(samples * SIZE, samples * SIZE).rays().astype(np.float64)
    along = -(rays @ camera.centre) / np.linalg.norm(rays, axis=-1)
    hit = DISTANCE**2 - along**2 < 1
    return hit.reshape(SIZE, samples, SIZE, samples).mean((1, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def cameras(camera_ring):
    """Cameras that see the same circle at different subpixel positions, so that aliasing averages out."""
    shifts = np.random.default_rng(0).uniform(-3, 3, (12, 2)) + SIZE / 2
    return [replace(c, cx=x, cy=y) for c, (x, y) in zip(camera_ring(12, size=SIZE, distance=DISTANCE), shifts, strict=True)]


@pytest.fixture(scope="module")
def masks(cameras):
    return [mask_of(c) for c in cameras]


@pytest.fixture(scope="module")
def pixel(cameras):
    """World size of a pixel at the sphere's outline."""
    return np.sqrt(DISTANCE**2 - 1) * np.sqrt(1 - 1 / DISTANCE**2) / cameras[0].fx


def sphere(radius):
    body = trimesh.creation.icosphere(5, radius)
    return np.asarray(body.vertices), np.asarray(body.faces)


@pytest.mark.parametrize("pixels", [0.5, 1.0, -0.5])
def test_known_offset_is_found(cameras, masks, pixel, pixels):
    found = silhouette_offset(*sphere(1 - pixels * pixel), cameras, masks)
    assert found == pytest.approx(pixels * pixel, rel=0.1)


def test_right_size_needs_nothing(cameras, masks, pixel):
    assert abs(silhouette_offset(*sphere(1.0), cameras, masks)) < 0.05 * pixel


def test_one_wrong_mask_does_not_matter(cameras, masks, pixel):
    spoilt = [np.ones_like(masks[0]), *masks[1:]]
    assert silhouette_offset(*sphere(1 - 0.5 * pixel), cameras, spoilt) == pytest.approx(0.5 * pixel, rel=0.1)


def test_what_is_no_bias_is_left_alone(cameras, masks, pixel):
    assert silhouette_offset(*sphere(1 - 4 * pixel), cameras, masks) == 0
    assert silhouette_offset(*sphere(1.0), cameras, [np.zeros_like(m) for m in masks]) == 0
