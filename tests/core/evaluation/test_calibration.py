# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration of the confidence: ratio and curve of errors that are known."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.evaluation.calibration import PARTS, Calibration
from irgspp.core.evaluation.ground_truth import Truth


@pytest.fixture(scope="module")
def erring(demo):
    """Function that gives a perfect view an error of its roughness and a confidence, both of each pixel."""
    _, _, _, truths, predictions = demo

    def make(error, confidence):
        buffers = predictions[0].buffers
        layers = np.repeat(confidence[..., None], 3, -1).astype(np.float32)
        return replace(predictions[0], buffers=replace(buffers, roughness=buffers.roughness + error, confidence=layers)), truths[0]

    return make


def test_confidence_that_falls_with_the_error_has_a_large_ratio(erring, demo):
    shape = demo[3][0].alpha.shape
    error = np.random.default_rng(0).random(shape)
    for confidence, low, high in ((1 - error, 3.5, 4.2), (error, 0.05, 0.1), (np.random.default_rng(1).random(shape), 0.7, 1.4)):
        calibration = Calibration()
        calibration.gather(*erring(error, confidence), np.ones(3))
        figures = calibration.figures()
        assert low < figures["roughness_confidence_ratio"] < high
        assert max(figures["albedo_confidence_ratio"], figures["metallic_confidence_ratio"]) < 1e-3  # no error anywhere


def test_curve_goes_from_the_least_sure_to_the_surest(erring, demo):
    error = np.random.default_rng(0).random(demo[3][0].alpha.shape)
    calibration = Calibration()
    for _ in range(2):
        calibration.gather(*erring(error, 1 - error), np.ones(3))
    curve = calibration.curves()["roughness"]
    assert len(curve) == PARTS
    assert [part["error"] for part in curve] == sorted((part["error"] for part in curve), reverse=True)
    assert all(part["confidence"] == pytest.approx(1 - part["error"], abs=1e-3) for part in curve)


def test_albedo_is_compared_after_its_scale(erring, demo):
    shape = demo[3][0].alpha.shape
    prediction, truth = erring(np.zeros(shape), np.ones(shape))
    dim = replace(prediction, buffers=replace(prediction.buffers, albedo=prediction.buffers.albedo * 0.5))
    for scale, known in ((np.full(3, 2.0), True), (None, False)):
        calibration = Calibration()
        calibration.gather(dim, truth, scale)
        assert ("albedo" in calibration.curves()) == known
        assert max((part["error"] for part in calibration.curves().get("albedo", [])), default=0) < 1e-6


def test_nothing_is_said_without_confidence_or_truth(erring, demo):
    shape = demo[3][0].alpha.shape
    prediction, truth = erring(np.zeros(shape), np.ones(shape))
    calibration = Calibration()
    calibration.gather(replace(prediction, buffers=replace(prediction.buffers, confidence=None)), truth, np.ones(3))
    calibration.gather(prediction, Truth(truth.image, truth.alpha), np.ones(3))
    assert calibration.figures() == calibration.curves() == {}


def test_directions_of_the_light_count_by_their_solid_angle():
    calibration = Calibration()
    polar = np.arange(32) < 4  # the upper 22.5 degrees: 3.8 % of the sphere, but an eighth of the texels
    error = np.repeat(np.where(polar, 0.5, 0.1)[:, None], 64, 1)
    calibration.gather_light(1 - error, error)
    curve = calibration.curves()["environment"]
    assert curve[0]["error"] == pytest.approx(0.1 + 0.4 * 0.38, abs=0.02) and curve[1]["error"] == pytest.approx(0.1)
    assert calibration.figures()["environment_confidence_ratio"] == pytest.approx(curve[0]["error"] / 0.1, rel=0.02)
