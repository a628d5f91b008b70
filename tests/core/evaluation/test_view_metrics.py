# SPDX-License-Identifier: GPL-3.0-or-later
"""Metrics of views: perfect where everything is right, and as expected where one thing is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.evaluation.ground_truth import Truth
from irgspp.core.evaluation.view_metrics import albedo_metrics, averages, view_metrics


def test_the_ground_truth_itself_is_perfect(demo):
    _, _, _, truths, predictions = demo
    measured = view_metrics(predictions[0], truths[0])
    for name in ("nvs", "radiance", "relight_studio", "relight_sunset"):
        # Edge pixels of a relit image have their own rounding of alpha.
        assert measured[f"{name}_psnr"] > (60 if name.startswith("relight") else 90)
        assert measured[f"{name}_ssim"] == pytest.approx(1, abs=1e-3)
    assert measured["normal_mae"] == pytest.approx(0, abs=0.05)
    assert [measured[f"{name}_mae"] for name in ("depth", "roughness", "metallic")] == [0, 0, 0]
    rows, scale = albedo_metrics(predictions, truths)
    assert np.allclose(scale, 1) and all(row["albedo_psnr"] == 100 for row in rows)


def test_each_metric_responds_to_its_own_error(demo):
    _, _, _, truths, predictions = demo
    b = predictions[0].buffers
    wrong = replace(predictions[0], buffers=replace(b, depth=b.depth + 0.25, roughness=b.roughness + 0.1, metallic=1 - b.metallic))
    measured = view_metrics(wrong, truths[0])
    assert measured["depth_mae"] == pytest.approx(0.25, abs=1e-5)
    assert measured["roughness_mae"] == pytest.approx(0.1, abs=1e-5)
    assert measured["metallic_mae"] > 0.9
    flipped = view_metrics(replace(predictions[0], buffers=replace(b, normal=-b.normal)), truths[0])
    assert flipped["normal_mae"] == pytest.approx(180, abs=0.1)
    covered = (truths[0].depth > 0).mean()  # the background counts as no error there
    assert flipped["normal_mae_full"] == pytest.approx(180 * covered, abs=0.5)


def test_metal_that_is_none_is_counted_over_the_object(demo):
    _, _, _, truths, predictions = demo
    b, inside = predictions[0].buffers, truths[0].object
    dielectric = inside & (truths[0].metallic <= 0.5 / 255)
    rows = np.cumsum(dielectric).reshape(dielectric.shape)
    claimed = dielectric & (rows <= dielectric.sum() // 4)
    wrong = replace(predictions[0], buffers=replace(b, metallic=np.where(claimed, 0.6, b.metallic)))
    assert view_metrics(wrong, truths[0])["metallic_false_fraction"] == pytest.approx(claimed.sum() / inside.sum(), abs=1e-6)
    unsure = replace(predictions[0], buffers=replace(b, metallic=np.where(dielectric, 0.5, b.metallic)))
    assert view_metrics(unsure, truths[0])["metallic_false_fraction"] == 0
    doubtful = replace(truths[0], metallic=np.where(claimed, 0.1, truths[0].metallic))  # not certain to be no metal
    assert view_metrics(wrong, doubtful)["metallic_false_fraction"] == 0


def test_a_view_without_anything_counts_as_missing_normals(demo):
    _, _, _, truths, predictions = demo
    b = predictions[0].buffers
    empty = replace(predictions[0], buffers=replace(b, alpha=np.zeros_like(b.alpha)))
    measured = view_metrics(empty, truths[0])
    assert measured["normal_mae"] == 90
    assert measured["radiance_psnr"] < 20 < measured["nvs_psnr"]


def test_one_albedo_scale_serves_all_views(demo):
    _, _, _, truths, predictions = demo
    dim = [replace(p, buffers=replace(p.buffers, albedo=p.buffers.albedo * np.array([0.5, 1.0, 2.0], np.float32))) for p in predictions]
    rows, scale = albedo_metrics(dim, truths)
    assert np.allclose(scale, [2, 1, 0.5], rtol=1e-4)
    assert all(row["albedo_psnr"] > 80 and row["albedo_psnr_unscaled"] < 25 for row in rows)


def test_without_ground_truth_only_images_are_compared(demo):
    _, _, _, truths, predictions = demo
    bare = Truth(truths[0].image, truths[0].alpha)
    assert {name.split("_")[0] for name in view_metrics(predictions[0], bare)} == {"nvs", "radiance"}
    assert albedo_metrics(predictions[:1], [bare]) == ([{}], None)


def test_means_are_over_the_views_that_have_the_metric():
    rows = [{"a_psnr": 10.0, "relight_x_psnr": 20.0, "relight_y_psnr": 30.0}, {"a_psnr": 20.0}]
    assert averages(rows, ["x", "y"]) == {"a_psnr": 15.0, "relight_x_psnr": 20.0, "relight_y_psnr": 30.0, "relight_psnr": 25.0}
