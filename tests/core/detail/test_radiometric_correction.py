# SPDX-License-Identifier: GPL-3.0-or-later
"""Gain, low frequencies, edges and sharpness of single photographs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from detail_reference import lens_pixels
from irgspp.core.detail.albedo_detail import AlbedoDetail
from irgspp.core.detail.candidates import Candidates
from irgspp.core.detail.evidence import MIN_CORRELATION_GAIN, Evidence
from irgspp.core.detail.mesh_depth import render_mesh_depth
from irgspp.core.detail.radiometric_correction import edge_weight, smooth_ratio
from irgspp.core.detail.sharpness import relative_blur
from irgspp.core.detail.texel_sampling import CODES
from irgspp.core.scene.camera import Camera, look_at


def test_a_gain_and_a_smooth_veil_are_taken_off(written):
    work = AlbedoDetail(written.mesh, written.reconstruction)
    photograph = written.photographs()[2]
    view = work._view(photograph)
    assert view.correction.gain == pytest.approx(np.ones(3), abs=0.06)  # the light is that of the photographs
    brighter = replace(view.photograph, reduced=view.photograph.reduced * [0.5, 0.6, 0.7])
    from irgspp.core.detail.radiometric_correction import fit_correction

    other = fit_correction(brighter, written.mesh, work._albedo, view.shading)
    assert other.gain == pytest.approx(view.correction.gain * [0.5, 0.6, 0.7], rel=1e-3)


def test_ratios_are_smooth_and_bounded():
    mask = np.zeros((60, 60), np.float32)
    mask[10:50, 10:50] = 1
    slope = np.linspace(0.5, 1.0, 60)[None, :, None]
    images = np.dstack([mask[..., None] * slope * np.ones(3), mask[..., None] * 0.5 * np.ones(3), mask]).astype(np.float32)
    ratio = smooth_ratio(images, 3.0)
    assert np.abs(ratio[20:40, 20:40] - 2 * slope[:, 20:40]).max() < 0.02
    assert np.isfinite(ratio).all() and ratio.max() <= 4


def test_photographs_of_any_size_are_corrected():
    """Sizes that are no multiples of the reduction's step, on which the filter of a wide window works."""
    images = np.ones((83, 131, 7), np.float32)
    images[..., :3] = 0.8
    images[..., 3:6] = 0.5
    ratio = smooth_ratio(images, 40.0)
    assert ratio.shape == (83, 131, 3)
    np.testing.assert_allclose(ratio, 1.6, rtol=1e-2)


def test_weights_fall_to_zero_at_steps_of_depth_and_at_masks_but_not_on_slopes():
    column = np.arange(40)[None] * np.ones((40, 1))
    inverse = 0.2 + 0.004 * column  # a slanted plane
    assert edge_weight(inverse, None)[10:30, 10:30].min() == 1
    inverse[:, 20:] = 0.1  # a farther one
    assert edge_weight(inverse, None)[10:30, 19:21].max() == 0 and edge_weight(inverse, None)[20, 10] == 1
    alpha = (column < 30).astype(np.float32)
    assert edge_weight(np.full((40, 40), 0.2), alpha)[20, 29] == 0


@pytest.mark.parametrize("sigma", [2.0, 4.0])
def test_a_photograph_out_of_focus_is_told_from_a_sharp_one(written, sigma):
    decoded = written.photographs()[1].load()
    blurred = cv2.GaussianBlur(decoded.pyramid[0], (0, 0), sigma)
    soft = replace(decoded, pyramid=(blurred, *decoded.pyramid[1:]))
    assert relative_blur(decoded) < 1.6
    assert relative_blur(soft) > 1.4 * relative_blur(decoded)


@pytest.mark.parametrize("fisheye", [False, True])
def test_undistorted_photographs_match_their_pinhole_cameras(written, fisheye):
    decoded = written.photographs()[0].load()
    coefficients = (0.08, -0.02, 0.01, 0.0) if fisheye else (-0.12, 0.04, 0.002, -0.001, 0.0)
    lens = replace(decoded.lens, distortion=coefficients, fisheye=fisheye)
    row, column = np.mgrid[:240, :240]
    waves = np.round(127 + 100 * np.sin(0.15 * column) * np.cos(0.11 * row))
    codes = np.repeat(waves[..., None], 3, -1).astype(np.uint8)
    distorted = replace(decoded, lens=lens, pyramid=(codes,))
    camera = Camera(100, 100, 140.0, 140.0, 50.0, 50.0, look_at((3, 0, 0)))
    image = distorted.undistorted(camera)[50, 30]
    u, v = lens_pixels(lens, np.array([(30.5 - 50) / 140]), np.array([(50.5 - 50) / 140]))
    expected = decoded.linear[round(127 + 100 * np.sin(0.15 * (u[0] - 0.5)) * np.cos(0.11 * (v[0] - 0.5)))]
    assert np.abs(image - expected).max() < 0.03


def test_evidence_is_fine_detail_that_held_back_photographs_share(written):
    texels, random = written.texels(64), np.random.default_rng(0)
    count = len(texels.index)
    truth, noise, flat = 0.2 + 0.4 * random.random((count, 3)), 0.2 + 0.4 * random.random((count, 3)), np.full((count, 3), 0.4)
    colour, finest = np.round(0.7 * truth * CODES).astype(np.uint16)[:, None], np.full(count, 0.05, np.float32)
    held = Candidates(colour, np.ones((count, 1), np.float32), finest)
    for new, old, good in ((truth, flat, True), (noise, flat, False), (flat, truth, False), (truth, truth, False)):
        evidence = Evidence(texels)
        evidence.add(held, new.astype(np.float32), old.astype(np.float32))
        assert evidence.convincing(MIN_CORRELATION_GAIN) == good
    few = Evidence(texels)
    weight = held.weight * (np.arange(count) < 50)[:, None]
    few.add(Candidates(held.colour, weight, held.finest), truth.astype(np.float32), flat.astype(np.float32))
    assert few.compared == 50 and not few.convincing(MIN_CORRELATION_GAIN)


def test_parts_behind_the_camera_are_left_out():
    vertices = np.array([[0, 0, 1], [1, 0, 1], [0, 1, -1]], np.float32)
    camera = Camera(8, 8, 8.0, 8.0, 4.0, 4.0, np.eye(4))
    assert (render_mesh_depth(vertices, np.array([[0, 1, 2]]), camera).triangle == -1).all()


def test_the_evidence_knows_how_much_of_the_object_is_relief(written):
    work = AlbedoDetail(written.mesh, replace(written.reconstruction, relief=0.25))
    assert work.held_back([], work.plain).relief == 0.25


@pytest.mark.parametrize(("strength", "colour", "painted"), [(0.05, 0.0, False), (0.05, 0.5, True), (0.4, 0.0, True)])
def test_weak_detail_without_colour_may_be_shading(written, strength, colour, painted):
    """All photographs agree about it, as they do about the shading of relief under a light that stands still."""
    texels = written.texels(128)
    count, random = len(texels.index), np.random.default_rng(3)
    noise = random.normal(size=(2, count))
    albedo = 0.3 * np.exp(strength * noise[0])[:, None] * np.exp(strength * colour * noise[1][:, None] * [1, 0, -1])
    held = Candidates.empty(count, 1)
    held.colour[:, 0] = np.clip(albedo * CODES, 0, CODES)
    held.weight[:], held.finest[:] = 1, np.median(texels.side)
    evidence = Evidence(texels)
    evidence.add(held, albedo.astype(np.float32), np.full((count, 3), 0.3, np.float32))
    assert evidence.correlations[0] > 0.9 and evidence.painted is painted and evidence.convincing(MIN_CORRELATION_GAIN) is painted
    assert ("shading of fine relief" in evidence.reason) is not painted
    carved, flat = replace(evidence, relief=0.9), replace(evidence, relief=0.2)
    assert carved.painted is painted and carved.reason == evidence.reason
    assert flat.painted and flat.convincing(MIN_CORRELATION_GAIN)  # the mesh has no relief, so it is paint
