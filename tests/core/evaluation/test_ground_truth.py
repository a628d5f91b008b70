# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground truth is read in the world frame of the run; the layers of the embedded dataset agree with each other."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.evaluation.ground_truth import SceneTruth, load_scene_truth, load_truth, rotate_to_frame
from irgspp.core.scene.dataset import View
from irgspp.core.shading.environment_lookup import lookup, texel_directions
from irgspp.core.shading.procedural_lights import sky_light
from scipy.spatial import KDTree


def similarity() -> np.ndarray:
    """Return a rotation about a skew axis with a scale of 2 and a translation."""
    axis = np.array([0.6, -0.3, 0.7])
    axis /= np.linalg.norm(axis)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = 2 * (np.eye(3) + np.sin(1.1) * skew + (1 - np.cos(1.1)) * skew @ skew)
    matrix[:3, 3] = [1, 2, 3]
    return matrix


def test_embedded_dataset_is_small_and_complete(demo):
    path, dataset, scene, truths, _ = demo
    assert sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) < 1_000_000
    assert len(dataset.train) >= 32 and len(dataset.test) == 6 and dataset.has_alpha
    assert dataset.train[0].camera.width == 64
    assert scene.train_light == "sky" and list(scene.lights) == ["sky", "studio", "sunset"]
    for truth in truths:
        assert list(truth.relit) == ["studio", "sunset"]
        assert truth.object.sum() > 500
        assert truth.metallic[truth.object].max() == 1 and truth.metallic[truth.object].min() == 0
        assert np.ptp(truth.roughness[truth.object]) > 0.2
        assert np.allclose(np.linalg.norm(truth.normal[truth.object], axis=-1), 1, atol=1e-3)


def test_depth_leads_to_the_surface_and_normals_face_the_camera(demo):
    _, dataset, scene, truths, _ = demo
    points, normals = scene.points
    tree = KDTree(points)
    for view, truth in zip(dataset.test, truths, strict=True):
        rays = view.camera.rays().astype(float)[truth.object]
        place = view.camera.centre + truth.depth[truth.object][:, None] * rays
        distance, nearest = tree.query(place)
        off_plane = np.abs(((place - points[nearest]) * normals[nearest]).sum(-1))
        assert np.median(distance) < 0.05 and np.median(off_plane) < 0.004
        assert ((truth.normal[truth.object] * rays).sum(-1) < 0.02).mean() > 0.99


def test_images_are_lit_from_where_the_light_map_says(demo):
    """Unshadowed diffuse shading explains each image best with its own light, not with the same light mirrored or turned."""
    _, _, scene, truths, _ = demo
    light = scene.lights["sunset"]

    def correlation(candidate: np.ndarray) -> float:
        direction = texel_directions(*candidate.shape[:2], torch.float64).numpy()
        power = candidate.mean(-1) * np.sqrt(1 - direction[..., 2] ** 2)
        shading, seen = [], []
        for truth in truths:
            cosine = np.clip(truth.normal[truth.object] @ direction.reshape(-1, 3).T, 0, None)
            shading.append(cosine @ power.reshape(-1) * truth.albedo[truth.object].mean(-1))
            seen.append((truth.relit["sunset"][truth.object] ** 2.2).mean(-1))
        return float(np.corrcoef(np.concatenate(shading), np.concatenate(seen))[0, 1])

    right = correlation(light)
    assert right > 0.6
    assert all(right > correlation(wrong) + 0.15 for wrong in (light[:, ::-1], light[::-1], np.roll(light, 16, 1), np.roll(light, -16, 1)))


def test_light_maps_turn_with_the_world():
    light, matrix = sky_light(64, 128), similarity()
    direction = torch.nn.functional.normalize(torch.randn(200, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    there = direction @ torch.from_numpy(matrix[:3, :3] / 2).float().T
    moved = lookup(torch.from_numpy(rotate_to_frame(light, matrix)), there)
    assert torch.median((moved - lookup(torch.from_numpy(light), direction)).abs()) < 0.01
    assert np.array_equal(rotate_to_frame(light, np.diag([3.0, 3.0, 3.0, 1.0])), light)


def test_layers_follow_the_world_frame_of_the_run(demo):
    path, dataset, _, truths, _ = demo
    matrix = similarity()
    scene = load_scene_truth(path, matrix)
    moved = load_truth(dataset.test[0], scene, matrix)
    assert np.allclose(moved.depth, 2 * truths[0].depth)
    assert np.allclose(moved.normal, truths[0].normal @ (matrix[:3, :3] / 2).T, atol=1e-5)
    assert np.allclose(np.linalg.norm(scene.points[1], axis=-1), 1, atol=1e-2)


def test_photographs_alone_have_only_an_image(demo, tmp_path):
    _, dataset, _, _, _ = demo
    assert vars(load_scene_truth(tmp_path, np.eye(4))) == vars(SceneTruth())
    view = dataset.train[0]
    truth = load_truth(View(view.name, view.camera, view.path, view.colour, None), SceneTruth(), np.eye(4))
    assert truth.albedo is None and not truth.relit and truth.object.all()


def test_ground_truth_is_reduced_with_the_view(demo):
    _, dataset, scene, truths, _ = demo
    view, whole = dataset.test[0], truths[0]
    small = View(view.name, view.camera.resized(32, 32), view.path, view.colour[::2, ::2], view.alpha[::2, ::2])
    half = load_truth(small, scene, np.eye(4))
    inside = whole.object.reshape(32, 2, 32, 2).all((1, 3))
    assert half.albedo.shape == half.normal.shape == half.relit["studio"].shape == (32, 32, 3) and inside.sum() > 100
    for name in ("albedo", "depth", "roughness"):
        layer = getattr(whole, name)
        blocks = layer.reshape(32, 2, 32, 2, *layer.shape[2:]).mean((1, 3))
        assert np.allclose(getattr(half, name)[inside], blocks[inside], atol=1e-4)
    assert np.allclose(np.linalg.norm(half.normal[inside], axis=-1), 1, atol=1e-4)


def test_ground_truth_of_another_shape_is_bad_input(demo):
    _, dataset, scene, _, _ = demo
    view = dataset.test[0]
    small = View(view.name, view.camera.resized(32, 40), view.path, np.zeros((40, 32, 3), np.float32), np.ones((40, 32), np.float32))
    with pytest.raises(InputError, match="64x64, the view 32x40"):
        load_truth(small, scene, np.eye(4))


def test_broken_description_is_bad_input(tmp_path):
    (tmp_path / "meta.json").write_text("[1, 2")
    with pytest.raises(InputError, match=r"meta\.json"):
        load_scene_truth(tmp_path, np.eye(4))
