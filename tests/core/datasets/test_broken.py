# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad input raises an InputError of one line that names the file and the reason, and nothing else."""

import struct
import zlib

import numpy as np
import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.image import image_size, read_image, read_mask
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import DataSettings
from PIL import Image

NAN = float("nan")


def fails(path, *words, **given_settings):
    with pytest.raises(InputError) as caught:
        load_dataset(path, DataSettings(**given_settings))
    text = str(caught.value)
    assert "\n" not in text and all(w in text for w in words), text


def test_no_folder_and_nothing_in_it(tmp_path):
    fails(tmp_path / "none", str(tmp_path / "none"), "no such")
    fails(tmp_path, str(tmp_path), "transforms.json", "sparse/0")
    (tmp_path / "a.txt").write_text("x")
    fails(tmp_path / "a.txt", "not a dataset")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.pop("frames"), ["frames"]),
        (lambda c: c.update(frames=[]), ["no frames"]),
        (lambda c: c.update(frames=[1, 2, 3]), ["frame 0"]),
        (lambda c: c.update(frames=c["frames"][:2]), ["2 training views", "3"]),
        (lambda c: c["frames"][1].pop("file_path"), ["frame 1", "file_path"]),
        (lambda c: c["frames"][1].pop("transform_matrix"), ["frame 1", "transform_matrix"]),
        (lambda c: c["frames"][1].update(transform_matrix=[[1, 2], [3]]), ["frame 1", "matrix"]),
        (lambda c: c["frames"][1].update(transform_matrix="x"), ["frame 1", "matrix"]),
        (lambda c: c["frames"][1].update(transform_matrix=np.eye(2).tolist()), ["frame 1", "(2, 2)"]),
        (lambda c: c["frames"][1]["transform_matrix"][2].__setitem__(3, NAN), ["frame 1", "not finite"]),
        (lambda c: c["frames"][1]["transform_matrix"][2].__setitem__(3, 1e30), ["frame 1", "infinity"]),
        (lambda c: c["frames"][1].update(transform_matrix=(2 * np.eye(4)).tolist()), ["frame 1", "not rigid"]),
        (lambda c: c["frames"][1].update(transform_matrix=np.diag([1, 1, -1, 1]).tolist()), ["frame 1", "not rigid"]),
        (lambda c: c["frames"][1]["transform_matrix"][3].__setitem__(0, 0.5), ["frame 1", "last row"]),
        (lambda c: c.pop("fl_x"), ["fl_x", "camera_angle_x"]),
        (lambda c: c.update(fl_x=NAN), ["fl_x", "finite"]),
        (lambda c: c.update(fl_x="wide"), ["fl_x", "number"]),
        (lambda c: c.update(fl_x=-5), ["focal"]),
        (lambda c: c.update(cx=1e12), ["principal point"]),
        (lambda c: c.update(w=0), ["w", "size"]),
        (lambda c: c.update(w=61), ["001.png", "60x48", "61x48"]),
        (lambda c: c.update(camera_model="EQUIRECTANGULAR"), ["EQUIRECTANGULAR", "OPENCV"]),
        (lambda c: c.update(camera_model=7), ["unknown camera model"]),
        (lambda c: c.update(camera_model="OPENCV", k4=0.1), ["k4"]),
        (lambda c: c.update(k1=-30.0), ["distortion"]),
        (lambda c: (c.pop("fl_x"), c.update(camera_angle_x=4.0)), ["camera_angle_x", "pi"]),
        (lambda c: c["frames"][2].update(mask_path="gone.png"), ["gone.png", "mask"]),
        (lambda c: c.update(ply_file_path="gone.ply"), ["gone.ply"]),
        (lambda c: [f.update(file_path="x" + f["file_path"]) for f in c["frames"]], ["none of its 10 images"]),
        (lambda c: [f.update(file_path="a\0b") for f in c["frames"]], ["file_path"]),
        (lambda c: [f.update(file_path="a" * 5000) for f in c["frames"]], ["impossible file"]),
    ],
)
def test_transforms_content(ball_dataset, change, words):
    path = ball_dataset.transforms()
    ball_dataset.edit(path, change)
    fails(ball_dataset.folder, str(path.parent), *words)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", '{"frames": 3}', "\udcff", "[" * 100_000])
def test_transforms_that_are_no_json(tmp_path, text):
    (tmp_path / "transforms.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    fails(tmp_path, "transforms.json")


def spoil(path, how):
    data = path.read_bytes()
    path.write_bytes({"empty": b"", "text": b"hello", "half": data[: len(data) // 2], "tail": data[:-30], "head": data[:20]}[how])


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("how", ["empty", "text", "half", "head"])
def test_one_broken_image_is_left_out_and_all_broken_is_an_error(ball_dataset, how, suffix):
    names = [f"images/{i}.{suffix}" for i in range(10)]
    ball_dataset.transforms(names=names, alpha=False)
    spoil(ball_dataset.folder / names[3], how)
    data = load_dataset(ball_dataset.folder)
    assert len(data.train) == 7 and len(data.warnings) == 1 and f"3.{suffix}" in data.warnings[0]
    for name in names[:3] + names[4:8]:
        spoil(ball_dataset.folder / name, how)
    fails(ball_dataset.folder, f"1.{suffix}", "can't be used")


def test_images_that_are_all_text_are_blamed_and_not_the_cameras(ball_dataset):
    path = ball_dataset.transforms(alpha=False)
    ball_dataset.edit(path, lambda c: (c.pop("w"), c.pop("h")))
    for image in (ball_dataset.folder / "images").iterdir():
        image.write_text("no image")
    fails(ball_dataset.folder, "none of the images can be read", "copy them again")


def test_a_broken_test_image_is_left_out(ball_dataset):
    ball_dataset.transforms()
    spoil(ball_dataset.folder / "images/000.png", "half")
    assert [v.name for v in load_dataset(ball_dataset.folder).test] == ["008"]


def test_three_views_and_one_broken_is_an_error(ball_dataset):
    path = ball_dataset.transforms()
    ball_dataset.edit(path, lambda c: c.update(frames=c["frames"][:3]))
    assert len(load_dataset(path).train) == 3
    spoil(ball_dataset.folder / "images/001.png", "half")
    fails(path, "001.png", "truncated")


def test_one_image_of_another_size(ball_dataset):
    ball_dataset.transforms()
    Image.fromarray(ball_dataset.images[0]).resize((30, 24)).save(ball_dataset.folder / "images/004.png")
    fails(ball_dataset.folder, "004.png", "30x24", "60x48")


def test_transparent_images(ball_dataset):
    path = ball_dataset.folder / "images/001.png"
    ball_dataset.transforms()
    Image.fromarray(ball_dataset.images[0] * 0).save(path)
    data = load_dataset(ball_dataset.folder)
    assert "001.png" in data.warnings[0] and "transparent" in data.warnings[0]
    for i in range(10):
        Image.fromarray(ball_dataset.images[0] * 0).save(ball_dataset.folder / f"images/{i:03d}.png")
    fails(ball_dataset.folder, "001.png", "transparent everywhere")


def test_mask_of_another_size(ball_dataset):
    ball_dataset.transforms(alpha=False)
    (ball_dataset.folder / "masks").mkdir()
    for i in range(10):
        Image.new("L", (50, 50), 255).save(ball_dataset.folder / f"masks/{i:03d}.png")
    fails(ball_dataset.folder, "masks", "50x50", "60x48")


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bomb(depth, colour_type):
    header = struct.pack(">IIBBBBB", 60_000, 60_000, depth, colour_type, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 10_000)) + chunk(b"IEND", b"")


def test_a_bomb_among_photographs_is_left_out_with_a_warning(ball_dataset):
    ball_dataset.transforms()
    (ball_dataset.folder / "images/003.png").write_bytes(png_bomb(16, 6))
    data = load_dataset(ball_dataset.folder)
    assert len(data.train) == 7 and any("003.png" in w and "60000x60000" in w for w in data.warnings)


def test_a_bomb_is_refused_before_it_is_decoded(tmp_path):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_bomb(8, 2))
    for read in (image_size, read_image, read_mask):
        with pytest.raises(InputError, match=r"bomb\.png"):
            read(path)


@pytest.mark.parametrize("values", [dict(resolution=0), dict(radius=-1.0), dict(radius=NAN), dict(centre=(NAN, 0.0, 0.0))])
def test_settings_that_make_no_sense(ball_dataset, values):
    ball_dataset.transforms()
    fails(ball_dataset.folder, "data.", **values)


def test_cancelling_stops_the_reading(ball_dataset):
    ball_dataset.transforms()
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        load_dataset(ball_dataset.folder, progress=progress)


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("cameras.txt", "PINHOLE", "FOV", ["FOV", "SIMPLE_RADIAL"]),
        ("cameras.txt", "PINHOLE", "OPENCV", ["takes 8 parameters"]),
        ("cameras.txt", "70.0", "nan", ["not finite"]),
        ("cameras.txt", "70.0", "-70.0", ["focal"]),
        ("cameras.txt", "60 48", "60 x", ["line 2"]),
        ("cameras.txt", "60 48", "60 50", ["001.png", "60x48", "60x50"]),
        ("images.txt", " 1 003.png", " 9 003.png", ["003.png", "camera 9"]),
        ("images.txt", " 1 003.png", "", ["line"]),
        ("points3D.txt", " 0.5 1 0 2 1\n", "\n", ["line 2"]),
    ],
)
def test_colmap_text(ball_dataset, file, old, new, words):
    path = ball_dataset.colmap(binary=False) / file
    path.write_text(path.read_text().replace(old, new, 1))
    fails(ball_dataset.folder, "001.png" if "001.png" in words else file, *words)


@pytest.mark.parametrize("value", ["inf", "nan"])
def test_points_at_infinity(ball_dataset, value):
    path = ball_dataset.colmap(binary=False) / "points3D.txt"
    rows = path.read_text().split("\n")
    rows[5] = f"4 {value} 0 0 1 2 3 0.5 1 0"
    path.write_text("\n".join(rows))
    fails(ball_dataset.folder, "points3D.txt", "1 of 300", "infinity")


def test_all_points_far_away(ball_dataset):
    ball_dataset.colmap(binary=True, points=1e8 * (1 + ball_dataset.surface()))
    fails(ball_dataset.folder, "sparse", "infinity")


def test_unknown_binary_camera_model(ball_dataset):
    path = ball_dataset.colmap(binary=True) / "cameras.bin"
    data = bytearray(path.read_bytes())
    data[12:16] = struct.pack("<i", 77)
    path.write_bytes(data)
    fails(ball_dataset.folder, "cameras.bin", "unknown camera model", "77")


@pytest.mark.parametrize(("file", "record"), [("cameras.bin", "camera"), ("images.bin", "image"), ("points3D.bin", "point")])
def test_truncated_binaries(ball_dataset, file, record):
    path = ball_dataset.colmap(binary=True) / file
    whole = path.read_bytes()
    for size in (0, 5, 8, 20, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        fails(ball_dataset.folder, file, "truncated")
    path.write_bytes(struct.pack("<Q", 2**63) + whole[8:])
    fails(ball_dataset.folder, file, "truncated", record)


def test_colmap_without_images(ball_dataset):
    model = ball_dataset.colmap(binary=True)
    (ball_dataset.folder / "images").rename(ball_dataset.folder / "other")
    fails(model, "images_2")
    (ball_dataset.folder / "images").mkdir()
    fails(model, "images", "000.png")


def test_cameras_at_one_place(ball_dataset):
    ball_dataset.poses = [ball_dataset.poses[0]] * 10
    ball_dataset.transforms(alpha=False)
    fails(ball_dataset.folder, "one place")
