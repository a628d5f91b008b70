# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture of a box on a table from files to a dataset; the poses are the true ones, which tests/core/capture/test_poses.py covers."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture import capture as module
from irgspp.core.capture import posed_photographs
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
from scripts_folder import scripts_on_path

SETTINGS = CaptureSettings()
LEFT_OUT = [LeftOut("stray", "matches no other photograph")]


@pytest.fixture(scope="module")
def photographs(table_scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("table") / "photographs"
    folder.mkdir()
    for view in table_scene.views:
        Image.fromarray(np.round(255 * view.colour).astype(np.uint8)).save(folder / f"{view.name}.png")
    return folder


def stand_in_poses(patch, table_scene):
    """Replace structure from motion by the true cameras; returns the names that it was asked for."""
    asked = []

    def find_poses(photographs, folder, settings, seed, progress, turntable=None):
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

    patch.setattr(module, "find_poses", find_poses)
    return asked


def be_quick(patch, dense):
    """Leave out what `test_a_folder_becomes_a_dataset` covers: stereo, here and before the refinement of poses, and the contact sheet."""

    def find(views, points, sphere, seed, progress):
        return dense if sphere is None else replace(dense, target=np.array(sphere.centre))

    patch.setattr("irgspp.core.capture.object_masks.find_dense_points", find)
    patch.setattr("irgspp.core.capture.pose_refinement.find_dense_points", find)
    patch.setattr(module, "write_contact_sheet", lambda *_: None)


@pytest.fixture
def true_poses(table_scene, monkeypatch):
    return stand_in_poses(monkeypatch, table_scene)


@pytest.fixture
def quick(dense, monkeypatch):
    be_quick(monkeypatch, dense)


@pytest.fixture(scope="module")
def finished(photographs, table_scene, dense, heard, tmp_path_factory):
    """A finished capture, and what it said."""
    folder, progress = tmp_path_factory.mktemp("finished") / "captured", heard()
    with pytest.MonkeyPatch.context() as patch:
        stand_in_poses(patch, table_scene)
        be_quick(patch, dense)
        capture(photographs, folder, SETTINGS, 0, progress)
    return folder, progress.messages


@pytest.fixture
def captured(finished, tmp_path):
    """A copy of the finished capture, to be changed."""
    return shutil.copytree(finished[0], tmp_path / "captured")


@pytest.fixture(scope="module")
def chosen(finished, table_scene, dense, tmp_path_factory):
    """The finished capture after another object was chosen on the command line by the numbers of the log's line, and its sphere."""
    folder, sphere = shutil.copytree(finished[0], tmp_path_factory.mktemp("chosen") / "captured"), sphere_of_the_other_thing(finished[1])
    with pytest.MonkeyPatch.context() as patch:
        stand_in_poses(patch, table_scene)
        be_quick(patch, dense)
        assert main(["capture", str(folder), "--sphere", *map(str, sphere)]) == 0
    return folder, sphere


def test_a_folder_becomes_a_dataset(photographs, table_scene, true_poses, heard, tmp_path, monkeypatch):
    marker = MarkerScale("4X4 id 7", 0.2, 5, 0.1)
    monkeypatch.setattr(posed_photographs, "find_marker_scale", lambda model, side, read: marker)
    progress = heard()
    folder = capture(photographs, tmp_path / "captured", replace(SETTINGS, marker=0.05), 0, progress)
    data = load_dataset(folder)
    views = [*data.train, *data.test]
    assert data.format == "capture" and len(views) == len(table_scene.views)
    assert min(overlap(view.alpha, table_scene.masks[view.name]) for view in views) > 0.9
    # One unit of the scene is 0.2 m; the box, 1 unit high, stands on Z = 0.
    assert 0.8 * 0.2 * 0.6 < data.bound.radius < 1.4 * 0.2 * 0.6
    assert data.bound.centre[2] == pytest.approx(0.2 * 0.5, abs=0.015) and data.bound.floor == 0
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


def test_a_stopped_capture_goes_on(photographs, true_poses, quick, heard, tmp_path):
    second = heard()
    with pytest.raises(Cancelled):
        capture(photographs, tmp_path / "captured", SETTINGS, 0, heard(steps=3))
    with pytest.raises(InputError, match="not finished"):
        load_dataset(tmp_path / "captured")
    capture(photographs, tmp_path / "captured", SETTINGS, 0, second)
    assert "left out stray: matches no other photograph" in second.messages
    assert load_dataset(tmp_path / "captured").has_alpha


def test_a_finished_capture_is_kept(photographs, true_poses, captured, heard):
    written = {file: file.stat().st_mtime_ns for file in captured.rglob("*") if file.is_file()}
    progress = heard()
    capture(photographs, captured, SETTINGS, 0, progress)
    assert not true_poses and "finished before" in progress.messages[-1]
    assert {file: file.stat().st_mtime_ns for file in written} == written


def poses_of(folder):
    data = load_dataset(folder)
    return {view.name: view.camera.to_world for view in (*data.train, *data.test)}


def sphere_of_the_other_thing(lines):
    (line,) = [line for line in lines if "1 other thing near the object left out" in line]
    return [float(word) for word in line.partition("X Y Z RADIUS ")[2].partition(";")[0].split()]


def test_a_sphere_chooses_another_object_in_place(photographs, true_poses, quick, finished, chosen, heard, tmp_path, capsys):
    """The cameras stay, and so does the frame."""
    before, automatic = poses_of(finished[0]), load_dataset(finished[0]).bound
    (*centre, radius), folder = chosen[1], shutil.copytree(chosen[0], tmp_path / "captured")
    data, after = load_dataset(folder), poses_of(folder)
    assert all(np.allclose(after[name], before[name], atol=1e-9) for name in after)
    assert np.allclose((*data.bound.centre, data.bound.radius), (*centre, radius), rtol=1e-6)
    truth = other_things_masks()
    assert data.has_alpha and min(overlap(view.alpha, truth[view.name]) for view in (*data.train, *data.test)) > 0.85
    left_out = {one["name"]: one["reason"] for one in json.loads((folder / "capture.json").read_text())["left_out"]}
    assert left_out["view07"] == "other things hide the object" and set(left_out) == {"stray", *(set(before) - set(after))}
    assert "a given sphere holds" in (folder / "report.html").read_text()
    again = heard()
    capture(photographs, folder, replace(SETTINGS, centre=tuple(centre), radius=radius), 0, again)
    assert "finished before" in again.messages[-1]
    words = ["--set", "capture.centre=none", "--set", "capture.radius=none"]  # back to the object that is found
    capsys.readouterr()
    assert main(["capture", str(folder), *words]) == 0
    assert np.allclose(load_dataset(folder).bound.centre, automatic.centre) and set(poses_of(folder)) == set(before)
    assert capsys.readouterr().out.splitlines() == [str(folder)]


def other_things_masks():
    with scripts_on_path() as script:
        scenes = script("stresses.table_scene")
    return scenes.photographed_table((scenes.CLUTTER, scenes.OBJECT)).masks


def test_a_sphere_means_the_same_without_an_earlier_capture(photographs, true_poses, quick, chosen, heard, tmp_path):
    in_place, (*centre, radius) = chosen
    straight, progress = tmp_path / "straight", heard()
    capture(photographs, straight, replace(SETTINGS, centre=tuple(centre), radius=radius), 0, progress)
    assert any("cut out without it first" in line for line in progress.messages)
    one, other = poses_of(in_place), poses_of(straight)
    assert all(np.allclose(one[name], other[name], atol=1e-9) for name in one)
    names = [file.name for file in (in_place / "masks").iterdir()]
    assert names and all((in_place / "masks" / name).read_bytes() == (straight / "masks" / name).read_bytes() for name in names)


def test_a_wrong_sphere_or_a_stop_leaves_the_dataset(photographs, true_poses, quick, captured, heard, capsys):
    before = {file: file.read_bytes() for file in captured.rglob("*") if file.is_file() and file.name != ".lock"}
    for sphere, words in (("0 0 90 1", "is shown by 0 of 12"), ("0 0 0 900", "cameras inside"), ("0.8 0 1 .1", "holds no point")):
        assert main(["capture", str(captured), "--sphere", *sphere.split()]) == 2
        error = capsys.readouterr().err
        assert words in error and "Traceback" not in error
    assert main(["capture", str(captured), "--set", "capture.radius=1"]) == 2
    assert "without capture.centre" in capsys.readouterr().err
    assert main(["capture", str(captured), "--sphere", "0", "0", "1", "-1"]) == 2
    assert "capture.radius" in capsys.readouterr().err
    with pytest.raises(Cancelled):
        capture(photographs, captured, replace(SETTINGS, centre=(0.0, 0.0, 1.0), radius=1.1), 0, heard(steps=9))
    assert {file: file.read_bytes() for file in before} == before
    assert load_dataset(captured).has_alpha


def test_edited_masks_are_kept_beside(photographs, true_poses, quick, captured, heard):
    mask = captured / "masks" / "view02.png"
    Image.new("L", Image.open(mask).size, 255).save(mask)
    edited, progress = mask.read_bytes(), heard()
    capture(photographs, captured, replace(SETTINGS, centre=(0.0, 0.0, 0.85), radius=1.1), 0, progress)
    assert [file.name for file in (captured / "edited_masks").iterdir()] == ["view02.png"]
    assert (captured / "edited_masks" / "view02.png").read_bytes() == edited != mask.read_bytes()
    assert any("1 that were edited" in line for line in progress.messages)


def test_a_capture_is_changed_in_its_place(photographs, captured, tmp_path, capsys):
    assert main(["capture", str(captured), "-o", str(tmp_path / "other")]) == 2
    assert "is changed in its place" in capsys.readouterr().err
    assert main(["capture", str(photographs)]) == 2
    assert "add -o DATASET" in capsys.readouterr().err
    state = json.loads((captured / "capture.json").read_text())
    state["inputs"]["source"] = str(tmp_path / "gone")
    (captured / "capture.json").write_text(json.dumps(state))
    assert main(["capture", str(captured), "--sphere", "0", "0", "1", "1"]) == 2
    assert "photographs that are gone" in capsys.readouterr().err


def test_without_masks_the_whole_scene_is_kept_and_a_missing_marker_is_said(photographs, true_poses, quick, heard, tmp_path):
    progress = heard()
    folder = capture(photographs, tmp_path / "captured", replace(SETTINGS, masks=False, marker=0.05), 0, progress)
    data = load_dataset(folder)
    assert not data.has_alpha and data.surroundings is None and not (folder / "masks").exists()
    assert json.loads((folder / "capture.json").read_text())["bound"] is None
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
    assert main(["inspect", str(photographs), "--export", str(tmp_path / "dataset")]) == 2
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
    assert main(["capture", str(photographs), "-o", str(tmp_path / "out"), "--turntable", "on"]) == 2
    assert "of the pixels stay the same over the photographs: the camera moved" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["capture", str(tmp_path / "none"), "-o", str(tmp_path / "other")]) == 2
    assert sorted(p.name for p in two.iterdir()) == ["view00.png", "view01.png"]
