# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a dataset: the cameras of the unreduced photographs, points, and the summary."""

import json
from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.cli.main import main
from irgspp.core.datasets.export import save_dataset
from irgspp.core.datasets.load import load_dataset
from irgspp.core.datasets.summary import describe, summary
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.core.settings.schema import DataSettings
from PIL import Image

SMALL = DataSettings(resolution=16)  # smaller than any image
FULL = DataSettings(resolution=1000)


@pytest.fixture
def distorted_dataset(tmp_path):
    """Dataset with lens distortion: gradients of 40x30 pixels, one of them broken."""
    from irgspp.core.scene.camera import look_at

    frames = []
    for i in range(6):
        y, x = np.mgrid[:30, :40]
        image = np.stack([6 * x, 8 * y, np.full((30, 40), 40 * i)], -1).astype(np.uint8)
        Image.fromarray(image).save(tmp_path / f"{i}.png")
        pose = look_at((2 * np.cos(i), 2 * np.sin(i), 0.5 + 0.1 * i))
        frames.append({"file_path": f"{i}.png", "transform_matrix": pose.tolist()})
    (tmp_path / "5.png").write_bytes(b"no image")
    lens = {"fl_x": 50.0, "fl_y": 48.0, "cx": 19.0, "cy": 16.0, "w": 40, "h": 30, "k1": -0.15, "k2": 0.02, "camera_model": "OPENCV"}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return tmp_path


def test_cameras_are_those_of_the_unreduced_images(tmp_path):
    save_dataset(load_dataset(DEMO_DATA, SMALL), SMALL, tmp_path, Silent())
    full = load_dataset(DEMO_DATA, FULL)
    placed = load_run_cameras(tmp_path / "cameras.json")
    expected = [("train", v) for v in full.train] + [("test", v) for v in full.test]
    for record, (split, view) in zip(placed, expected, strict=True):
        assert (record.split, record.name, record.image) == (split, view.name, view.path.resolve())
        same = ("width", "height", "fx", "fy", "cx", "cy")
        assert [getattr(record.camera, n) for n in same] == [getattr(view.camera, n) for n in same]
    assert not (tmp_path / "photographs").exists() and not (tmp_path / "points.npz").exists()


def test_distorted_photographs_are_undistorted_at_full_size(distorted_dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("export")
    save_dataset(load_dataset(distorted_dataset, SMALL), SMALL, out, Silent())
    data = load_dataset(distorted_dataset, FULL)
    views = [*data.train, *data.test]
    placed = load_run_cameras(out / "cameras.json")
    assert [p.name for p in placed] == [v.name for v in views] == list("12340")  # without the broken one
    for record, view in zip(placed, views, strict=True):
        assert record.image.is_relative_to(out) and (record.camera.fx, record.camera.width) == (view.camera.fx, 40)
        shown = np.asarray(Image.open(record.image), float) / 255
        assert np.abs(shown - view.colour).mean() < 0.01  # but for the losses of a JPEG


def test_points_and_summary(tmp_path):
    data = load_dataset(DEMO_DATA, SMALL)
    from irgspp.core.scene.dataset import PointCloud

    cloud = PointCloud(np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32), np.full((50, 3), 0.2, np.float32))
    save_dataset(replace(data, points=cloud), SMALL, tmp_path, Silent())
    with np.load(tmp_path / "points.npz") as stored:
        assert np.array_equal(stored["position"], cloud.position) and (stored["colour"] == 51).all()
    exported = json.loads((tmp_path / "dataset.json").read_text())
    assert (exported["train"], exported["test"], exported["points"], exported["masked"], exported["distorted"]) == (40, 6, 50, 40, 0)
    assert exported["sizes"] == [[16, 16, 46]] and 0.2 < exported["object_share"] < 0.5 and exported["warnings"] == []
    assert [name for name, _ in exported["rows"]] == [line[:10].strip() for line in describe(replace(data, points=cloud)).splitlines()]
    save_dataset(data, SMALL, tmp_path, Silent())
    assert not (tmp_path / "points.npz").exists()  # nothing of an earlier export stays


def test_a_cancelled_export_is_incomplete(tmp_path):
    data, progress = load_dataset(DEMO_DATA, SMALL), Silent()
    save_dataset(data, SMALL, tmp_path, progress)
    progress.cancelled = True
    with pytest.raises(Cancelled):
        save_dataset(data, SMALL, tmp_path, progress)
    assert not (tmp_path / "dataset.json").exists()


def test_a_folder_that_cannot_be_created_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file.* can't be written"):
        save_dataset(load_dataset(DEMO_DATA, SMALL), SMALL, tmp_path / "file", Silent())


def test_command_prints_the_exported_summary(distorted_dataset, tmp_path_factory, capsys):
    out = tmp_path_factory.mktemp("export")
    assert main(["inspect", str(distorted_dataset), "--json", "--export", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "dataset.json").read_text())
    assert printed["distorted"] == 5 and printed["masked"] == 0 and printed["object_share"] is None
    assert any("5.png" in line for line in printed["warnings"])
    assert printed["lenses"] and printed == json.loads(json.dumps(summary(load_dataset(distorted_dataset))))
