# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouette offset of meshes that are too small or too large by a known fraction of a pixel, as a whole or in part."""

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


def _covered(camera, body, samples=3):
    """Return the fraction (H, W) of each pixel that a convex body covers."""
    rays = camera.resized(samples * SIZE, samples * SIZE).rays().reshape(-1, 3).astype(np.float64)
    hit = body.ray.intersects_any(np.repeat(camera.centre[None], len(rays), 0), rays)
    return hit.reshape(SIZE, samples, SIZE, samples).mean((1, 3)).astype(np.float32)


def sphere(radius):
    body = trimesh.creation.icosphere(5, radius)
    return np.asarray(body.vertices), np.asarray(body.faces)


@pytest.mark.parametrize("pixels", [0.5, 1.0, -0.5])
def test_known_offset_is_found(cameras, masks, pixel, pixels):
    found = silhouette_offset(*sphere(1 - pixels * pixel), cameras, masks)
    assert np.median(found) == pytest.approx(pixels * pixel, rel=0.2)
    assert np.abs(found - pixels * pixel).mean() < 0.3 * abs(pixels) * pixel


def test_right_size_needs_nothing(cameras, masks, pixel):
    found = silhouette_offset(*sphere(1.0), cameras, masks)
    assert abs(found.mean()) < 0.05 * pixel
    assert np.abs(found).mean() < 0.15 * pixel


def test_only_the_part_that_is_too_small_moves(cameras, masks, pixel):
    """One half of the sphere is half a pixel too small."""
    vertices, faces = sphere(1.0)
    small = vertices[:, 0] > 0
    found = silhouette_offset(vertices * np.where(small, 1 - 0.5 * pixel, 1)[:, None], faces, cameras, masks)
    assert np.median(found[vertices[:, 0] > 0.2]) == pytest.approx(0.5 * pixel, rel=0.3)
    assert abs(np.median(found[vertices[:, 0] < -0.2])) < 0.1 * pixel


def test_what_has_no_outline_stays(camera_ring, pixel):
    """Cameras on one side of a box see the middle of its top, but never its outline there."""
    body = trimesh.creation.box((2, 2, 0.5)).subdivide_to_size(0.1)
    above = [c for c in camera_ring(40, size=SIZE, distance=DISTANCE) if c.centre[2] > 0.5 * DISTANCE]
    masks = [_covered(c, trimesh.creation.box(np.array((2, 2, 0.5)) + pixel)) for c in above]
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    found = silhouette_offset(vertices, faces, above, masks)
    top = vertices[:, 2] > 0.24
    middle = top & (np.abs(vertices[:, :2]).max(-1) < 0.4)
    assert np.abs(found[middle]).max() < 0.02 * pixel
    assert found[top & (np.abs(vertices[:, :2]).max(-1) > 0.99)].mean() > 0.2 * pixel


def test_one_wrong_mask_does_not_matter(cameras, masks, pixel):
    for wrong in (np.ones_like(masks[0]), np.roll(masks[0], 30, 0), np.zeros_like(masks[0])):
        found = silhouette_offset(*sphere(1 - 0.5 * pixel), cameras, [wrong, *masks[1:]])
        assert np.median(found) == pytest.approx(0.5 * pixel, rel=0.25)


def test_what_is_no_bias_is_left_alone(cameras, masks, pixel):
    assert not silhouette_offset(*sphere(1 - 4 * pixel), cameras, masks).any()
    assert not silhouette_offset(*sphere(1.0), cameras, [np.zeros_like(m) for m in masks]).any()
