# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture of a box on a table from files to a dataset; the poses are the true ones, which tests/core/capture/test_poses.py covers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture import capture as module
from irgspp.core.capture.capture import capture
from irgspp.core.capture.marker import MarkerScale
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.photograph import LeftOut
from irgspp.core.capture.source import needs_capture, posed_dataset
from irgspp.core.capture.sparse_model import PosedPhotograph, SparseModel
from irgspp.core.cli.main import main
from irgspp.core.datasets.load import load_dataset
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.settings.schema import CaptureSettings
from PIL import Image

SETTINGS = CaptureSettings()
LEFT_OUT = [LeftOut("stray", "matches no other photograph")]


@pytest.fixture(scope="module")
def photographs(table_scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("table") / "photographs"
    folder.mkdir()
    for view in table_scene.views:
        Image.fromarray(np.round(255 * view.colour).astype(np.uint8)).save(folder / f"{view.name}.png")
    return folder


@pytest.fixture
def true_poses(table_scene, monkeypatch):
    """Replace structure from motion by the true cameras; returns the names that it was asked for."""
    asked = []

    def find_poses(photographs, folder, settings, seed, progress):
        asked.append([one.name for one in photographs])
        cameras = {view.name: view.camera for view in table_scene.views}
        posed, tracks, points = [], [], table_scene.points.position.astype(np.float64)
        for i, one in enumerate(photographs):
            c = cameras[one.name]
            posed.append(PosedPhotograph(one, Lens("PINHOLE", c.width, c.height, c.fx, c.fy, c.cx, c.cy), c.to_world))
            pixels, _ = c.project(points)
            inside = np.flatnonzero((pixels >= 0).all(1) & (pixels < (c.width, c.height)).all(1))
            tracks.append((inside, np.full(len(inside), i), pixels[inside]))
        point, photograph, pixel = (np.concatenate(part) for part in zip(*tracks, strict=True))
        colour = np.full((len(points), 3), 128, np.uint8)
        return SparseModel(
            posed, points, colour, point.astype(np.int32), photograph.astype(np.int32), pixel.astype(np.float32), 0.2, LEFT_OUT
        )

    monkeypatch.setattr(module, "find_poses", find_poses)
    return asked


@pytest.fixture
def known_points(dense, monkeypatch):
    """Replace stereo by the points that it finds in this scene."""
    monkeypatch.setattr("irgspp.core.capture.object_masks.find_dense_points", lambda *_: dense)


def test_a_folder_becomes_a_dataset(photographs, table_scene, true_poses, known_points, heard, tmp_path, monkeypatch):
    marker = MarkerScale("4X4 id 7", 0.2, 5, 0.1)
    monkeypatch.setattr(module, "find_marker_scale", lambda model, side, read: marker)
    progress = heard()
    folder = capture(photographs, tmp_path / "captured", replace(SETTINGS, marker=0.05), 0, progress)
    data = load_dataset(folder)
    views = [*data.train, *data.test]
    assert data.format == "capture" and len(views) == len(table_scene.views)
    assert min(overlap(view.alpha, table_scene.masks[view.name]) for view in views) > 0.9
    # One unit of the scene is 0.2 m; the box, 1 unit high, stands on Z = 0.
    assert 0.8 * 0.2 * 0.6 < data.bound.radius < 1.4 * 0.2 * 0.6
    assert data.bound.centre[2] == pytest.approx(0.2 * 0.5, abs=0.015)
    first = next(view.camera for view in views if view.name == "view00")
    assert first.centre[1] < 0 and abs(first.centre[0]) < 0.05 * abs(first.centre[1])  # in front
    table = data.surroundings.position[np.abs(data.surroundings.position[:, 2]) < 0.004]
    assert len(table) > 200 and np.hypot(*table[:, :2].T).min() < 0.03  # also below the box
    assert (np.linalg.norm(data.surroundings.position - (0, 0, 0.1), axis=1) < 0.05).sum() == 0  # none inside it
    state = json.loads((folder / "capture.json").read_text())
    assert state["status"] == "done" and state["masked"] and state["plane"] and state["metres_per_unit"] == 1.0
    assert [one["mask"] for one in state["photographs"]] == ["found"] * len(views)
    page = (folder / "report.html").read_text()
    assert str(photographs) in page and "view03" in page and Image.open(folder / "contact_sheet.png").width > 500
    assert any(line.startswith("marker 4X4 id 7") for line in progress.messages)


def test_a_finished_capture_is_kept_and_a_stopped_one_goes_on(photographs, true_poses, known_points, heard, tmp_path):
    second = heard()
    with pytest.raises(Cancelled):
        capture(photographs, tmp_path / "captured", SETTINGS, 0, heard(steps=3))
    with pytest.raises(InputError, match="not finished"):
        load_dataset(tmp_path / "captured")
    capture(photographs, tmp_path / "captured", SETTINGS, 0, second)
    written = {file: file.stat().st_mtime_ns for file in (tmp_path / "captured").rglob("*") if file.is_file()}
    asked = len(true_poses)
    progress = heard()
    capture(photographs, tmp_path / "captured", SETTINGS, 0, progress)
    assert len(true_poses) == asked and "finished before" in progress.messages[-1]
    assert "left out stray: matches no other photograph" in second.messages
    assert {file: file.stat().st_mtime_ns for file in written} == written


def test_without_masks_the_whole_scene_is_kept(photographs, true_poses, heard, tmp_path):
    folder = capture(photographs, tmp_path / "captured", replace(SETTINGS, masks=False), 0, heard())
    data = load_dataset(folder)
    assert not data.has_alpha and data.surroundings is None and not (folder / "masks").exists()
    assert json.loads((folder / "capture.json").read_text())["bound"] is None


def test_a_missing_marker_is_said(photographs, true_poses, heard, tmp_path):
    progress = heard()
    capture(photographs, tmp_path / "captured", replace(SETTINGS, masks=False, marker=0.05), 0, progress)
    assert any("no marker was found" in line for line in progress.messages)


def test_folder_with_other_files_is_refused(photographs, tmp_path):
    (tmp_path / "letter.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty and not a capture"):
        capture(photographs, tmp_path, SETTINGS)
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def test_what_needs_a_capture(photographs, tmp_path):
    assert needs_capture(photographs) and not needs_capture(DEMO_DATA) and not needs_capture(tmp_path / "none")
    (tmp_path / "clip.MP4").write_bytes(b"video")
    assert needs_capture(tmp_path / "clip.MP4")
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "transforms.json").write_text("{")
    (broken / "a.jpg").write_bytes(b"")
    assert not needs_capture(broken)  # its reader says what is wrong


def test_run_knows_the_capture_of_its_photographs(photographs, tmp_path):
    assert posed_dataset(DEMO_DATA) == DEMO_DATA
    with pytest.raises(InputError, match="has photographs but no cameras"):
        posed_dataset(photographs, tmp_path)
    (tmp_path / "capture").mkdir()
    state = {"format": "irgspp-capture", "status": "done", "inputs": {"source": str(photographs.resolve())}}
    (tmp_path / "capture" / "capture.json").write_text(json.dumps(state))
    assert posed_dataset(photographs, tmp_path) == tmp_path / "capture"
    (tmp_path / "capture" / "capture.json").write_text(json.dumps({**state, "inputs": {"source": "/elsewhere"}}))
    with pytest.raises(InputError, match="irgspp capture finds them"):
        posed_dataset(photographs, tmp_path)


def test_bad_input_of_the_command(photographs, tmp_path, capsys):
    assert main(["inspect", str(photographs)]) == 2
    assert "has photographs but no cameras" in capsys.readouterr().err
    two = tmp_path / "two"
    two.mkdir()
    for name in ("view00.png", "view01.png"):
        (two / name).write_bytes((photographs / name).read_bytes())
    assert main(["capture", str(two), "-o", str(tmp_path / "out")]) == 2
    assert "2 usable photographs, fewer than 3" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["capture", str(photographs), "-o", str(tmp_path / "out"), "--marker", "5"]) == 2
    assert "is not a length such as 50mm" in capsys.readouterr().err
    assert main(["capture", str(tmp_path / "none"), "-o", str(tmp_path / "other")]) == 2
    assert sorted(p.name for p in two.iterdir()) == ["view00.png", "view01.png"]
