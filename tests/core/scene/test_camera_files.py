# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of a run: written to cameras.json and read back unchanged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.camera_files import load_run_cameras, save_cameras
from irgspp.core.scene.dataset import Bound, Dataset, View
from PIL import Image


def make_dataset(*images: Path) -> Dataset:
    random = np.random.default_rng(0)
    views = []
    for i, path in enumerate(images):
        to_world = np.eye(4)
        to_world[:3, 3] = random.normal(size=3)
        to_world[:3, :3] = np.linalg.qr(random.normal(size=(3, 3)))[0]
        camera = Camera(31, 17, *random.uniform(10, 40, 4), to_world)
        views.append(View(f"v{i}", camera, path, np.zeros((17, 31, 3), np.float32), None))
    return Dataset(Path("data"), "transforms", views[:-1], views[-1:], Bound((0.0, 0.0, 0.0), 1.0), np.eye(4))


def test_rotation_of_the_light_is_kept(tmp_path):
    dataset = make_dataset(tmp_path / "a.png", tmp_path / "b.png")
    turned = replace(dataset, train=[replace(dataset.train[0], light_rotation=np.diag([-1.0, -1.0, 1.0]))])
    save_cameras(tmp_path / "cameras.json", turned)
    train, test = load_run_cameras(tmp_path / "cameras.json")
    assert np.array_equal(train.light_rotation, np.diag([-1, -1, 1])) and test.light_rotation is None
    records = json.loads((tmp_path / "cameras.json").read_text())
    records[0]["light_rotation"] = [1, 2]
    (tmp_path / "cameras.json").write_text(json.dumps(records))
    with pytest.raises(InputError, match="light_rotation"):
        load_run_cameras(tmp_path / "cameras.json")


def test_round_trip_is_exact(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    dataset = make_dataset(tmp_path / "photographs" / "a b.png", run / "own.png", tmp_path / "ü.jpg")
    save_cameras(run / "cameras.json", dataset)
    placed = load_run_cameras(run / "cameras.json")
    assert [p.split for p in placed] == ["train", "train", "test"]
    for record, view in zip(placed, dataset.train + dataset.test, strict=True):
        assert record.name == view.name and record.image == view.path
        assert np.array_equal(record.camera.to_world, view.camera.to_world)
        assert vars(record.camera) | {"to_world": 0} == vars(view.camera) | {"to_world": 0}
    assert [p.name for p in run.iterdir()] == ["cameras.json"]


def test_images_in_the_run_move_with_it(tmp_path):
    (tmp_path / "run").mkdir()
    save_cameras(tmp_path / "run" / "cameras.json", make_dataset(tmp_path / "run" / "own.png"))
    (tmp_path / "run").rename(tmp_path / "moved")
    assert load_run_cameras(tmp_path / "moved" / "cameras.json")[0].image == tmp_path / "moved" / "own.png"


def test_undistorted_copies_replace_distorted_photographs(tmp_path):
    dataset = make_dataset(tmp_path / "a.png", tmp_path / "b.png")
    colour = np.broadcast_to(np.linspace(0, 1, 31, dtype=np.float32)[None, :, None], (17, 31, 3))
    dataset.train[0] = replace(dataset.train[0], colour=colour, distorted=True)
    (tmp_path / "run").mkdir()
    save_cameras(tmp_path / "run" / "cameras.json", dataset)
    copy, original = (p.image for p in load_run_cameras(tmp_path / "run" / "cameras.json"))
    assert original == tmp_path / "b.png"
    assert copy == tmp_path / "run" / "photographs" / "train" / "v0.jpg"
    with Image.open(copy) as image:
        assert np.abs(np.asarray(image) / 255 - colour).max() < 0.05
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("content", ["", "{}x", "[{}]", "[1]", "3", json.dumps([{"name": "a", "split": "b", "to_world": [[1]]}])])
def test_broken_file_is_bad_input(tmp_path, content):
    (tmp_path / "cameras.json").write_text(content)
    with pytest.raises(InputError, match=r"cameras\.json"):
        load_run_cameras(tmp_path / "cameras.json")


def test_missing_file_is_bad_input(tmp_path):
    with pytest.raises(InputError, match=r"cameras\.json"):
        load_run_cameras(tmp_path / "cameras.json")
