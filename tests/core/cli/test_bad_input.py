# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad input: exit status 2, one line that names the file and the reason, no files left behind."""

import json
import shutil
import struct

import numpy as np
import pytest
from irgspp.core.cli.main import main
from irgspp.core.pipeline import DEMO_DATA
from PIL import Image


@pytest.fixture
def photos(tmp_path):
    """A copy of the demonstration dataset."""
    return shutil.copytree(DEMO_DATA, tmp_path / "photos")


def edit(photos, change):
    """Change the training cameras' JSON."""
    path = photos / "transforms_train.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def images(photos):
    return sorted((photos / "train").glob("*.png"))


def matrix(content, row, column, value):
    content["frames"][1]["transform_matrix"][row][column] = value


def write_colmap(photos, model=1, cut=0):
    """A COLMAP model of the images in binary: one camera, all poses alike, no points; `cut` bytes short."""
    folder = photos / "sparse" / "0"
    folder.mkdir(parents=True)
    for name in ("transforms_train.json", "transforms_test.json"):
        (photos / name).unlink()
    (photos / "train").rename(photos / "images")
    camera = struct.pack("<QiiQQ4d", 1, 1, model, 64, 64, 90, 90, 32, 32)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", 5)
    for i, path in enumerate(sorted((photos / "images").glob("*.png"))[:5]):
        images += struct.pack("<i7di", i + 1, 1, 0, 0, 0, i * 0.1, 0, 4, 1) + path.name.encode() + b"\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(images[: len(images) - cut])
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))


def truncate_all(photos):
    for path in images(photos):
        path.write_bytes(path.read_bytes()[:200])


def clear_all(photos):
    for path in images(photos):
        Image.fromarray(np.zeros((64, 64, 4), np.uint8)).save(path)


def other_size(photos):
    Image.fromarray(np.full((48, 64, 4), 255, np.uint8)).save(images(photos)[2])


BREAKS = {
    "missing folder": (shutil.rmtree, "photos: no such"),
    "empty folder": (lambda p: (shutil.rmtree(p), p.mkdir()), "photos: no dataset"),
    "not JSON": (lambda p: (p / "transforms_train.json").write_text("{"), "transforms_train.json: not valid JSON"),
    "no frames": (lambda p: edit(p, lambda c: c.update(frames=[])), "transforms_train.json: lists no frames"),
    "two views": (lambda p: edit(p, lambda c: c.update(frames=c["frames"][:2])), "transforms_train.json: has 2 training views"),
    "missing key": (lambda p: edit(p, lambda c: c.pop("camera_angle_x")), "camera_angle_x"),
    "missing matrix": (lambda p: edit(p, lambda c: c["frames"][1].pop("transform_matrix")), "transform_matrix"),
    "NaN": (lambda p: edit(p, lambda c: matrix(c, 0, 3, float("nan"))), "not finite"),
    "not rigid": (lambda p: edit(p, lambda c: matrix(c, 0, 0, 3.0)), "not rigid"),
    "truncated images": (truncate_all, "r_000.png: unreadable or truncated"),
    "transparent images": (clear_all, "r_000.png: is transparent everywhere"),
    "image of another size": (other_size, "is 64x48 but its camera is 64x64"),
    "unknown camera model": (lambda p: write_colmap(p, model=99), "unknown camera model"),
    "truncated binary": (lambda p: write_colmap(p, cut=30), "images.bin: truncated"),
}


@pytest.mark.parametrize("name", BREAKS)
def test_bad_dataset(photos, tmp_path, capsys, name):
    spoil, words = BREAKS[name]
    spoil(photos)
    assert main(["reconstruct", str(photos), "-o", str(tmp_path / "run")]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("irgspp: ")]
    assert len(lines) == 1
    assert words in lines[0]
    assert not (tmp_path / "run").exists()


def test_one_broken_image_is_left_out_with_a_warning(photos, capsys):
    path = images(photos)[3]
    path.write_bytes(path.read_bytes()[:200])
    assert main(["inspect", str(photos)]) == 0
    out = capsys.readouterr().out
    assert "39 training" in out
    assert f"warning   {path}" in out
