# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a captured dataset: the project's readers and pycolmap read what was written."""

import json

import numpy as np
import pycolmap
import pytest
from captured_scene import VIEWS, sparse_model
from irgspp.core.capture.dataset_files import write_json, write_masks, write_model, write_transforms
from irgspp.core.capture.undistortion import undistort_photographs
from irgspp.core.datasets.formats.captured import FORMAT, read_captured
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.similarity import moved_points
from irgspp.core.settings.schema import DataSettings

SIMILARITY = np.array([[0, -2.0, 0, 1], [2, 0, 0, -3], [0, 0, 2, 0.5], [0, 0, 0, 1]])
GAINS = {f"p{i}": [1 + 0.1 * i] * 3 for i in range(VIEWS)}
STATE = {"format": FORMAT, "status": "done", "bound": {"centre": [1, -3, 0.5], "radius": 1.5}}


@pytest.fixture
def captured(tmp_path):
    model = sparse_model(tmp_path / "photographs")
    images = undistort_photographs(model, tmp_path, 48, Silent())
    mask = np.zeros((36, 48), np.float32)
    mask[9:27, 12:36] = 1
    masks = [mask] * (VIEWS - 1) + [None]
    write_model(model, images, SIMILARITY, tmp_path)
    write_masks(images, masks, tmp_path)
    write_transforms(images, SIMILARITY, [one is not None for one in masks], tmp_path)
    write_json(tmp_path / "capture.json", STATE)
    write_json(tmp_path / "exposures.json", GAINS)
    return tmp_path, model, images


def test_reader_finds_cameras_points_masks_and_gains_in_the_world(captured):
    folder, model, images = captured
    parsed = read_captured(folder, DataSettings())
    np.testing.assert_array_equal(parsed.to_world, np.eye(4))
    assert parsed.bound.radius == 1.5
    for frame, one in zip(parsed.train, images, strict=True):
        np.testing.assert_allclose(frame.to_world, one.camera.moved(SIMILARITY).to_world, atol=1e-6)
        assert frame.lens.fx == pytest.approx(one.camera.fx) and frame.image == one.image
        np.testing.assert_allclose(frame.gain, GAINS[one.view.name])
        assert (frame.mask is None) == (one.view.name == f"p{VIEWS - 1}")
    np.testing.assert_allclose(parsed.points.position, moved_points(model.position, SIMILARITY), atol=1e-5)


def test_colmap_model_reprojects(captured):
    folder, model, _ = captured
    reconstruction = pycolmap.Reconstruction(folder / "sparse" / "0")
    assert len(reconstruction.images) == VIEWS
    assert len(reconstruction.points3D) == len(model.position)
    assert reconstruction.compute_num_observations() == len(model.track_point)
    reconstruction.update_point_3d_errors()
    assert reconstruction.compute_mean_reprojection_error() < 0.01


def test_transforms_and_cameras_agree(captured):
    folder, _, images = captured
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    records = json.loads((folder / "cameras.json").read_text())
    assert [frame.get("mask_path") for frame in frames] == [*(f"masks/p{i}.png" for i in range(VIEWS - 1)), None]
    for frame, record, one in zip(frames, records, images, strict=True):
        assert record["to_world"] == frame["transform_matrix"] and record["picture"] == frame["file_path"] == f"images/{one.view.name}.png"
        assert (folder / frame["file_path"]).is_file()
    (folder / "capture.json").unlink()
    (folder / "sparse" / "0" / "points3D.bin").unlink()  # without points, transforms.json has precedence
    assert load_dataset(folder).format == "nerfstudio"


def test_dataset_loads_with_even_exposure(captured):
    folder, _, _ = captured
    data = load_dataset(folder, DataSettings(resolution=48))
    assert data.format == "capture" and len(data.train) + len(data.test) == VIEWS
    corner = {view.name: view.colour[0, 0, 0] for view in (*data.train, *data.test)}
    assert corner["p0"] > corner["p2"] > corner["p5"]  # gains were removed
    masked = next(view for view in data.train if view.name == "p1").alpha
    assert masked[18, 24] > 0.99 and masked[2, 2] < 0.01


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({**STATE, "status": "running"}, "not finished; run irgspp capture again"),
        ({**STATE, "format": "other"}, "not a file of irgspp capture"),
        ({**STATE, "bound": {"centre": [0, 0, 0], "radius": -1}}, "is broken"),
        ([1, 2], "not a file of irgspp capture"),
    ],
)
def test_damaged_capture_json(captured, state, message):
    folder, _, _ = captured
    write_json(folder / "capture.json", state)
    with pytest.raises(InputError, match=message):
        read_captured(folder, DataSettings())


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        (None, "can't be read"),
        ({"p0": [1, 1, 1]}, "is broken"),
        ({name: [0, 1, 1] for name in GAINS}, "is broken"),
        ({name: [1, 1] for name in GAINS}, "is broken"),
        ({name: "bright" for name in GAINS}, "is broken"),
        ([1, 2], "is broken"),
    ],
)
def test_damaged_exposures(captured, gains, message):
    folder, _, _ = captured
    (folder / "exposures.json").unlink() if gains is None else write_json(folder / "exposures.json", gains)
    with pytest.raises(InputError, match=rf"exposures\.json: {message}.*run irgspp capture again"):
        read_captured(folder, DataSettings())


def test_masks_of_an_earlier_start_are_removed(captured):
    folder, _, images = captured
    assert len(list((folder / "masks").iterdir())) == VIEWS - 1
    write_masks(images, [None] * VIEWS, folder)
    assert not (folder / "masks").exists()
