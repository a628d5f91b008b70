# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered captures: what the photographs say agrees with their truth, and the truth can be moved into the world of a run."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import warm_engine
from irgspp.core.capture.exif import EXIF_IFD
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError
from irgspp.core.evaluation.ground_truth import load_scene_truth, load_truth
from irgspp.core.io.exr import read_exr_rgb
from irgspp.core.scene.similarity import moved_points
from irgspp.core.shading.environment_lookup import lookup
from PIL import Image
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scripts_folder import script as script

ROOT = Path(__file__).resolve().parents[2]
NUMBERS = {"photographs": 12, "samples": 2, "test": 2, "resolution": 40, "test-samples": 4, "points": 400, "light-height": 16}


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("capture")
    numbers = [word for name, value in NUMBERS.items() for word in (f"--{name}", str(value))]
    options = ["--size", "80", "60", "--relight", "studio", *numbers]
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder), "OMP_WAIT_POLICY": "PASSIVE"}
    python = warm_engine.engine(sys.executable)
    command = [python, str(ROOT / "scripts" / "render_capture.py"), "--scene", "demo", "-o", str(folder / "out"), *options]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "out"


@pytest.fixture(scope="module")
def similarity():
    moved = np.eye(4)
    moved[:3, :3] = 1.7 * Rotation.from_euler("xyz", (0.4, -0.9, 2.0)).as_matrix()
    moved[:3, 3] = 3.0, -2.0, 0.5
    return moved


@pytest.fixture(scope="module")
def aligned(capture, similarity, script, tmp_path_factory):
    """Truth in the world of a run that differs from the truth's by the similarity; one of its cameras is wrong."""
    run = tmp_path_factory.mktemp("run")
    records = []
    for number, frame in enumerate(frames_of(capture)):
        pose = np.array(frame["transform_matrix"])
        pose[:3, 3] = moved_points(pose[:3, 3], similarity) + (number == 3) * np.array([9.0, 0.0, 0.0])
        lens = {"width": 80, "height": 60, "fx": 65.0, "fy": 65.0, "cx": 40.0, "cy": 30.0}
        name = Path(frame["file_path"]).stem
        records.append({"name": name, "split": "train", "picture": f"{name}.jpg", "to_world": pose.tolist(), **lens})
    (run / "cameras.json").write_text(json.dumps(records))
    assert script("align_truth").main([str(run), str(capture), "-o", str(run / "truth")]) == 0
    return run / "truth"


def frames_of(capture):
    return json.loads((capture / "truth" / "transforms.json").read_text())["frames"]


def test_exif_tells_the_exposure_and_masks_show_the_object(capture):
    frames = frames_of(capture)
    assert len(frames) == NUMBERS["photographs"] == len(list((capture / "photos").iterdir()))
    for frame in frames:
        with Image.open(capture / "truth" / frame["file_path"]) as photograph:
            assert photograph.size == (80, 60)
            taken = photograph.getexif().get_ifd(EXIF_IFD)
        assert float(taken[0x829A]) == pytest.approx(frame["exposure_gain"] / 60, rel=1e-3)
        assert 0.7 < frame["exposure_gain"] < 1.4
        mask = np.asarray(Image.open(capture / "truth" / frame["mask_path"])) > 127
        assert 0.02 < mask.mean() < 0.6 and not mask[[0, -1]].any()


def test_photographs_show_the_surroundings(capture):
    """Beside the object there is a table: the photographs are neither black nor of one colour there."""
    for frame in frames_of(capture):
        pixels = np.asarray(Image.open(capture / "truth" / frame["file_path"]))
        beside = pixels[np.asarray(Image.open(capture / "truth" / frame["mask_path"])) == 0]
        assert beside.mean() > 10 and beside.std(0).min() > 5


def test_truth_moves_with_the_world(capture, similarity, aligned):
    before, after = (np.load(folder / "surface_points.npz") for folder in (capture / "truth", aligned))
    np.testing.assert_allclose(after["points"], moved_points(before["points"], similarity), atol=1e-4)
    dataset = load_dataset(aligned)
    assert len(dataset.test) == NUMBERS["test"]
    scene, points = load_scene_truth(aligned, dataset.to_world), moved_points(after["points"], dataset.to_world)
    for view in dataset.test:
        truth = load_truth(view, scene, dataset.to_world)
        seen = view.camera.centre + truth.depth[truth.object][:, None] * view.camera.rays()[truth.object]
        distance, nearest = KDTree(points).query(seen)
        close = distance < np.median(distance)  # the samples are sparse
        normals = after["normals"][nearest[close]] @ dataset.to_world[:3, :3].T
        assert distance.max() < 0.5 * 1.7
        assert np.median((normals * truth.normal[truth.object][close]).sum(1)) > 0.9


def test_light_turns_with_the_world(capture, similarity, aligned):
    before, after = (read_exr_rgb(folder / "envs" / "sky.exr") for folder in (capture / "truth", aligned))
    direction = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    turned = direction @ (similarity[:3, :3] / 1.7).T.astype(np.float32)
    expected, found = (lookup(*map(torch.from_numpy, pair)).numpy() for pair in ((before, direction), (after, turned)))
    assert np.corrcoef(expected.ravel(), found.ravel())[0, 1] > 0.97
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)


def test_too_few_cameras_are_refused(script):
    points = np.random.default_rng(0).random((3, 3))
    with pytest.raises(InputError, match="only 3"):
        script("align_truth").fitted_similarity(points, points)


def test_other_folders_are_refused(tmp_path, script, capsys):
    assert script("align_truth").main([str(tmp_path), str(tmp_path), "-o", str(tmp_path / "new")]) == 2
    assert "photos is missing" in capsys.readouterr().err.replace(":", "") and not (tmp_path / "new").exists()


def test_folders_that_exist_are_refused(capture, script, capsys):
    assert script("render_capture").main(["-o", str(capture)]) == 2
    assert script("align_truth").main([str(capture), str(capture), "-o", str(capture)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2
