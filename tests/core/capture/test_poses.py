# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses of photographs of a room's corner: near the truth, the same twice, continued after a stop; and sets that must be refused."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture.feature_database import lens_groups
from irgspp.core.capture.poses import MODEL, find_poses
from irgspp.core.datasets.formats.colmap_model import model_files, read_images
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera import look_at
from irgspp.core.settings.schema import CaptureSettings
from PIL import Image
from room_corner import cameras, take, texture, textures

SETTINGS = CaptureSettings()


class Steps(Silent):
    """Progress that remembers its phases and messages, and cancels after some steps of one phase."""

    def __init__(self, stop=None, after=0):
        self.phases, self.messages, self.cancelled, self._stop, self._after = [], [], False, stop, after

    def phase(self, name, steps):
        self.phases.append((name, steps))

    def step(self, done, **metrics):
        self.cancelled = self.cancelled or (self.phases[-1][0] == self._stop and done >= self._after)

    def message(self, text):
        self.messages.append(text)


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """Seven photographs, one of them held upright, and one that shows something else."""
    folder, walls = tmp_path_factory.mktemp("photographs"), textures()
    taken = take(folder, cameras(7), walls, turned={2: 1})
    (stray,) = take(folder / "stray", [look_at((2, 2, 1.5), (0.4, 0.4, 0.3))], [np.roll(w, 300, 0)[::-1] for w in walls])
    return [*taken, replace(stray, photograph=replace(stray.photograph, name="stray"))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("capture")


@pytest.fixture(scope="module")
def solved(shots, folder):
    progress = Steps()
    return find_poses([s.photograph for s in shots], folder, SETTINGS, 0, progress), progress


def aligned_errors(model, shots):
    """Distances of the camera centres in units and angles of the orientations in degrees, after the best similarity."""
    truth = {s.photograph.name: s.to_world for s in shots}
    found, true = (np.array(x) for x in zip(*((p.to_world, truth[p.photograph.name]) for p in model.posed), strict=True))
    a, b = found[:, :3, 3], true[:, :3, 3]
    u, d, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    turn = u * (1, 1, np.sign(np.linalg.det(u @ vt))) @ vt
    size = (d * (1, 1, np.sign(np.linalg.det(u @ vt)))).sum() / ((a - a.mean(0)) ** 2).sum()
    off = np.linalg.norm(size * (a - a.mean(0)) @ turn.T + b.mean(0) - b, axis=1)
    cosine = (np.trace(np.swapaxes(turn @ found[:, :3, :3], 1, 2) @ true[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    return off, np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_poses_are_near_the_truth(solved, shots):
    model, _ = solved
    off, angle = aligned_errors(model, shots)
    assert len(model.posed) == 7 and off.max() < 0.01 and angle.max() < 0.3
    assert model.error < 1 and len(model.position) > 200


def test_lenses_are_those_of_the_upright_copies(solved):
    model, _ = solved
    for posed in model.posed:
        assert posed.lens.size == (posed.photograph.width, posed.photograph.height)
        assert abs(posed.lens.fx / 290 - 1) < 0.03
    assert len({tuple(sorted((round(p.lens.fx, 6), round(p.lens.fy, 6)))) for p in model.posed}) == 1  # one lens, however it was held


def test_observations_are_where_the_points_project(solved):
    model, _ = solved
    error = []
    for k, posed in enumerate(model.posed):
        mine = model.track_photograph == k
        to_camera = np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(posed.to_world)
        x = model.position[model.track_point[mine]] @ to_camera[:3, :3].T + to_camera[:3, 3]
        x, lens = x[:, :2] / x[:, 2:], posed.lens
        r2, (k1, k2) = (x**2).sum(1, keepdims=True), (*lens.distortion, 0, 0)[:2]
        seen = x * (1 + k1 * r2 + k2 * r2**2) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        error.append(np.linalg.norm(seen - model.track_pixel[mine], axis=1))
    assert np.median(np.concatenate(error)) < 0.7


def test_points_have_the_colours_of_the_photographs(solved):
    model, _ = solved
    first = {int(p): i for i, p in reversed(list(enumerate(model.track_point)))}
    images = [np.asarray(Image.open(p.photograph.image)).astype(int) for p in model.posed]
    differences = []
    for point, i in first.items():
        column, row = model.track_pixel[i].astype(int)
        differences.append(np.abs(images[model.track_photograph[i]][row, column] - model.colour[point]).mean())
    assert np.median(differences) < 12


def test_a_photograph_of_something_else_is_left_out_with_its_reason(solved):
    model, _ = solved
    assert [one.name for one in model.left_out] == ["stray"] and "match" in model.left_out[0].reason


def test_the_model_is_written_for_the_upright_copies(solved, folder, shots):
    names = [image.name for image in read_images(model_files(folder / MODEL)["images"])]
    assert names == sorted(s.photograph.image.name for s in shots[:7])


def test_phases_tell_their_steps(solved):
    _, progress = solved
    assert progress.phases[:3] == [("find features", 8), ("match photographs", 28), ("find poses", 8)]


def equal(one, other):
    same = all((a.to_world == b.to_world).all() and a.lens == b.lens for a, b in zip(one.posed, other.posed, strict=True))
    arrays = ("position", "colour", "track_point", "track_photograph", "track_pixel")
    return same and all(np.array_equal(getattr(one, k), getattr(other, k)) for k in arrays) and one.left_out == other.left_out


def test_a_finished_model_is_read_back(solved, folder, shots):
    progress = Steps()
    again = find_poses([s.photograph for s in shots], folder, SETTINGS, 0, progress)
    assert equal(again, solved[0]) and not progress.phases


@pytest.mark.parametrize("phase", ["find features", "match photographs", "find poses"])
def test_cancelled_and_continued_gives_the_same(solved, folder, shots, tmp_path, phase):
    """Of the first run, a copy without what the phase and later ones have written."""
    photographs = [s.photograph for s in shots]
    if phase != "find features":
        shutil.copy(folder / "database.db", tmp_path)
        (tmp_path / "poses.json").write_text(json.dumps({"key": json.loads((folder / "poses.json").read_text())["key"]}))
    # Photographs that are at work while the third is finished may count as well.
    with pytest.raises(Cancelled, match="stopped after features were found in [3-7] " if phase == "find features" else "stopped while"):
        find_poses(photographs, tmp_path, SETTINGS, 0, Steps(phase, 3))
    assert not (tmp_path / MODEL).exists()
    if phase != "match photographs":
        assert equal(find_poses(photographs, tmp_path, SETTINGS, 0, Steps()), solved[0])


def test_a_damaged_database_is_made_again(shots, folder, tmp_path):
    data = (folder / "database.db").read_bytes()
    (tmp_path / "database.db").write_bytes(data[:4096] + bytes(len(data) // 2))
    (tmp_path / "poses.json").write_text(json.dumps({"key": json.loads((folder / "poses.json").read_text())["key"]}))
    progress = Steps("find features", 1)
    with pytest.raises(Cancelled):
        find_poses([s.photograph for s in shots], tmp_path, SETTINGS, 0, progress)
    assert progress.phases == [("find features", 8)]


def test_other_photographs_are_not_mistaken_for_the_earlier_ones(shots, folder, tmp_path):
    shutil.copytree(folder, tmp_path / "copy")
    progress = Steps("find features", 1)
    with pytest.raises(Cancelled):
        find_poses([s.photograph for s in shots[:5]], tmp_path / "copy", SETTINGS, 0, progress)
    assert progress.phases == [("find features", 5)]


def test_two_photographs_are_refused(shots, tmp_path):
    with pytest.raises(InputError, match=r"2 photographs are too few.*take 20"):
        find_poses([s.photograph for s in shots[:2]], tmp_path, SETTINGS, 0, Silent())


def test_photographs_without_texture_are_refused(tmp_path):
    plain = [np.full((1024, 1024, 3), value, np.uint8) for value in (90, 120, 150)]
    taken = take(tmp_path / "photographs", cameras(3), plain)
    with pytest.raises(InputError, match=r"almost no texture.*patterned surface"):
        find_poses([s.photograph for s in taken], tmp_path / "capture", SETTINGS, 0, Silent())


def test_photographs_from_one_place_are_refused(tmp_path):
    poses = [look_at((2.0, 2.0, 1.4), (0.4 + 0.1 * k, 0.5 - 0.08 * k, 0.4)) for k in range(4)]
    taken = take(tmp_path / "photographs", poses, textures())
    with pytest.raises(InputError, match=r"same place.*walk around"):
        find_poses([s.photograph for s in taken], tmp_path / "capture", SETTINGS, 0, Silent())


def test_photographs_that_do_not_overlap_are_refused(tmp_path):
    taken = [take(tmp_path / f"{k}", [pose], [texture(10 * k + j) for j in range(3)])[0] for k, pose in enumerate(cameras(3))]
    with pytest.raises(InputError, match=r"do not show the same surfaces.*overlapping"):
        find_poses([s.photograph for s in taken], tmp_path / "capture", SETTINGS, 0, Silent())


def test_lens_groups_join_one_lens_held_both_ways(shots):
    photographs = [s.photograph for s in shots]
    assert lens_groups(photographs) == [list(range(8))]
    other = replace(photographs[1], lens="another 320x240")
    assert lens_groups([photographs[0], other, photographs[2]]) == [[0, 2], [1]]
