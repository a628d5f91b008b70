# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of a dataset with cameras: the object is cut out, and the cameras stay."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture import capture as module
from irgspp.core.capture.capture import capture
from irgspp.core.capture.exposures import exposure_gains
from irgspp.core.capture.given_cameras import given_model, has_cameras
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.cli.main import main
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError
from irgspp.core.io.exr import rgb_channels, write_exr
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.scene.similarity import moved_points
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import CaptureSettings, Settings
from PIL import Image

SETTINGS = CaptureSettings()


@pytest.fixture(scope="module")
def photographs(table_scene, tmp_path_factory):
    """Folder of photographs with transforms.json."""
    folder, frames = tmp_path_factory.mktemp("photographs") / "posed", []
    (folder / "images").mkdir(parents=True)
    for view in table_scene.views:
        Image.fromarray(np.round(255 * view.colour).astype(np.uint8)).save(folder / "images" / f"{view.name}.png")
        c = view.camera
        lens = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
        frames.append({"file_path": f"images/{view.name}.png", "transform_matrix": c.to_world.tolist(), **lens})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder


@pytest.fixture
def posed(photographs, tmp_path, monkeypatch):
    """A copy of it; a search for poses fails the test."""
    monkeypatch.setattr(module, "find_poses", lambda *_: pytest.fail("poses were searched"))
    return shutil.copytree(photographs, tmp_path / "posed")


@pytest.fixture(scope="module")
def finished(photographs, dense, heard, tmp_path_factory):
    """The photographs cut out, and what was said."""
    folder, progress = tmp_path_factory.mktemp("finished") / "cut", heard()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "find_poses", lambda *_: pytest.fail("poses were searched"))
        patch.setattr("irgspp.core.capture.object_masks.find_dense_points", lambda *_: dense)
        capture(photographs, folder, SETTINGS, 0, progress)
    return folder, progress.messages


@pytest.fixture
def cut(finished, tmp_path):
    """A copy of it, to be changed."""
    return shutil.copytree(finished[0], tmp_path / "cut")


@pytest.fixture
def known_points(dense, monkeypatch):
    """Replace stereo by the points that it finds in this scene."""
    monkeypatch.setattr("irgspp.core.capture.object_masks.find_dense_points", lambda *_: dense)


def test_the_object_is_cut_out_and_the_cameras_stay(finished, table_scene):
    folder, messages = finished
    data = load_dataset(folder)
    views = {view.name: view for view in (*data.train, *data.test)}
    assert len(views) == len(table_scene.views) and data.surroundings is not None
    assert min(overlap(view.alpha, table_scene.masks[name]) for name, view in views.items()) > 0.9
    state = json.loads((folder / "capture.json").read_text())
    assert state["error"] is None and state["metres_per_unit"] is None and "that of the dataset" in (folder / "report.html").read_text()
    assert "the cameras of" in messages[0] and "are those of the dataset" in messages[0]
    similarity = np.array(json.loads((folder / "frame.json").read_text())["similarity"])
    assert np.cbrt(np.linalg.det(similarity[:3, :3])) == pytest.approx(1)  # the dataset's unit
    centres = moved_points(np.stack([view.camera.centre for view in table_scene.views]), similarity)
    np.testing.assert_allclose(np.stack([views[view.name].camera.centre for view in table_scene.views]), centres, atol=1e-5)


def test_a_sphere_chooses_the_object_of_posed_photographs(photographs, cut, known_points, heard, monkeypatch):
    monkeypatch.setattr(module, "find_poses", lambda *_: pytest.fail("poses were searched"))
    before = (cut / "transforms.json").read_text()
    bound = json.loads((cut / "capture.json").read_text())["bound"]
    sphere = [f"capture.centre={','.join(map(repr, bound['centre']))}", f"capture.radius={1.1 * bound['radius']}"]
    capture(photographs, cut, with_overrides(Settings(), sphere).capture, 0, heard())
    assert (cut / "transforms.json").read_text() == before
    assert json.loads((cut / "capture.json").read_text())["bound"]["radius"] == pytest.approx(1.1 * bound["radius"])


def test_two_points_give_the_true_size(photographs, cut, known_points, tmp_path, capsys):
    folder = str(cut)
    before = load_dataset(cut)
    assert main(["capture", folder, "--distance", "0", "0", "0", "0", "-1e-1", "0", "5mm"]) == 0
    after, state = load_dataset(cut), json.loads((cut / "capture.json").read_text())
    for one, other in zip(before.train, after.train, strict=True):
        np.testing.assert_allclose(0.05 * one.camera.centre, other.camera.centre, atol=1e-6)
    assert after.bound.radius == pytest.approx(0.05 * before.bound.radius, rel=1e-3)
    assert state["metres_per_unit"] == 1.0 and after.surroundings.spacing == pytest.approx(0.05 * before.surroundings.spacing, rel=1e-3)
    assert main(["capture", folder]) == 0  # finished before: nothing changes
    assert load_dataset(cut).bound == after.bound
    assert main(["capture", str(photographs), "-o", str(tmp_path / "new"), "--distance", *"000001", "5mm"]) == 2
    assert "--distance: needs a finished capture" in capsys.readouterr().err


def test_a_dataset_with_masks_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"has masks already.*reconstruct it as it is"):
        capture(DEMO_DATA, tmp_path / "cut", SETTINGS)
    assert not (tmp_path / "cut").exists()


@pytest.mark.parametrize("change", ["capture.turntable=on", "capture.marker=0.05"])
def test_what_belongs_to_a_search_for_poses_is_refused(posed, tmp_path, change):
    with pytest.raises(InputError, match="has its cameras"):
        capture(posed, tmp_path / "cut", with_overrides(Settings(), [change]).capture)
    assert not (tmp_path / "cut").exists()


def test_linear_images_are_refused(posed):
    state = json.loads((posed / "transforms.json").read_text())
    (posed / "images" / "view00.png").unlink()
    lens = state["frames"][0]
    write_exr(posed / "images" / "view00.exr", rgb_channels(np.full((lens["h"], lens["w"], 3), 0.2, np.float32)))
    with pytest.raises(InputError, match=r"view00\.exr.*is a linear image"):
        given_model(posed)


def test_photographs_that_are_gone_are_counted(posed):
    for number in range(len(list((posed / "images").glob("*.png"))) - 2):
        (posed / "images" / f"view{number:02}.png").unlink()
    with pytest.raises(InputError, match="has 2 photographs on the disk, at least 3 are needed"):
        given_model(posed)


def test_declared_test_views_stay_out(posed):
    frames = json.loads((posed / "transforms.json").read_text())["frames"]
    (posed / "transforms.json").unlink()
    for split, part in (("train", frames[:-2]), ("test", frames[-2:])):
        (posed / f"transforms_{split}.json").write_text(json.dumps({"frames": part}))
    assert len(given_model(posed).posed) == len(frames) - 2


def test_opaque_alpha_is_no_mask(posed):
    for file in (posed / "images").glob("*.png"):
        Image.open(file).convert("RGBA").save(file)
    assert len(given_model(posed).posed) == len(list((posed / "images").glob("*.png")))


def test_exposures_need_no_tracks(posed, table_scene):
    model = given_model(posed)
    assert model.error is None and not len(model.track_point)
    np.testing.assert_array_equal(exposure_gains(model, table_scene.views), 1)  # no points either
    place = table_scene.points.position.astype(np.float64)
    points = replace(model, position=place, colour=np.full((len(place), 3), 128, np.uint8))
    darker = [replace(view, colour=view.colour * (0.8 if i % 2 else 1)) for i, view in enumerate(table_scene.views)]
    gains = exposure_gains(points, darker).mean(1)
    assert gains[1::2].max() < 0.9 < gains[::2].min()


def test_bare_and_damaged_cameras_are_searched(posed, heard):
    progress = heard()
    assert has_cameras(posed, progress) and has_cameras(posed / "transforms.json", progress) and not progress.messages
    (posed / "transforms.json").write_text("{")
    assert not has_cameras(posed, progress)
    assert len(progress.messages) == 1 and "transforms.json" in progress.messages[0] and "searched instead" in progress.messages[0]
    (posed / "transforms.json").unlink()
    assert not has_cameras(posed, progress) and not has_cameras(posed / "gone", progress) and len(progress.messages) == 1
