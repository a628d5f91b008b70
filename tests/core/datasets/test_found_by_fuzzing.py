# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that once made a reader fail, found by scripts/faults.py: each is refused in one line now."""

import json
import pickle
import shutil
import struct
import zipfile
import zlib
from contextlib import closing

import numpy as np
import pytest
import torch
from irgspp.core.datasets.format_detection import parse_dataset
from irgspp.core.errors import InputError
from irgspp.core.evaluation.surface_truth import rendered_points
from irgspp.core.io.exr import exr_size, write_exr
from irgspp.core.io.image import image_size
from irgspp.core.io.safe_pickle import read_pickle
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.run_folder import RunFolder, read_run
from irgspp.core.scene.reconstruction import Reflections
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.overrides import from_dict
from irgspp.core.settings.schema import DataSettings, Settings


def refused(words):
    return pytest.raises(InputError, match=words)


def test_messages_are_short_whatever_stands_in_the_file():
    error = InputError("x" * 10**6, "y" * 10**6, "z" * 10**6)
    assert len(str(error)) < 4500 and "x ... x" in str(error)


def transforms(folder, change):
    shutil.copytree(DEMO_DATA / "train", folder / "train")
    content = json.loads((DEMO_DATA / "transforms_train.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def frame(content):
    return content["frames"][0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: frame(c)["transform_matrix"][0].__setitem__(0, 10**400), "not a matrix of numbers"),
        (lambda c: c.update(test_filenames=[f["file_path"] for f in c["frames"]]), "has no training views"),
        (lambda c: frame(c).update(mask_path="m" * 5000), "no such mask file"),
        (lambda c: c.update(ply_file_path="p" * 5000), "no such file"),
    ],
)
def test_transforms(tmp_path, change, words):
    with refused(words):
        parse_dataset(transforms(tmp_path, change), DataSettings())


def test_colmap_pose_with_one_value_that_is_no_number(tmp_path):
    """Python's max() ignores a NaN that does not come first."""
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 8 8 9 9 4 4\n")
    (tmp_path / "images.txt").write_text("".join(f"{i} 1 0 0 0 {i} nan 3 1 {i}.png\n\n" for i in range(4)))
    with refused("not finite"):
        parse_dataset(tmp_path, DataSettings())


def test_metashape_in_an_encoding_that_is_none(tmp_path):
    (tmp_path / "cameras.xml").write_text('<?xml version="1.0" encoding="UTF-88"?>\n<document><chunk></chunk></document>')
    with refused("not valid XML"):
        parse_dataset(tmp_path / "cameras.xml", DataSettings())


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"seed": 0', '"seed": Infinity'),
        lambda text: text.replace('"seed": 0', '"seed": 1e999'),
        lambda text: text.replace('"phases": {', '"phases": {"first stage": 1, "x": {').replace("}\n", "}}\n", 1),
        lambda text: text.replace('"phases": {}', '"phases": {"first stage": 7}'),
        lambda text: text.replace('"phases": {}', '"phases": {"first stage": {"seconds": "x", "peak_memory": 1, "finished": true}}'),
        lambda text: text.replace('"phases": {}', '"phases": {"first stage": {"seconds": "nan", "peak_memory": 1, "finished": true}}'),
        lambda text: text.replace('"phases": {}', '"phases": {"first stage": {"seconds": "1e999", "peak_memory": 1, "finished": true}}'),
        lambda text: text.replace('"phases": {}', '"phases": []'),
        lambda text: "[" * 10**5,
    ],
)
def test_run_json(tmp_path, change):
    RunFolder.open(tmp_path / "run", Settings(), "photos").close()
    file = tmp_path / "run" / "run.json"
    text = file.read_text()
    assert change(text) != text
    file.write_text(change(text))
    with refused("is broken"):
        read_run(tmp_path / "run")


def test_setting_beyond_all_floats():
    with refused("is not a number"):
        from_dict({"time": 10**400})


def test_checkpoint_that_lost_a_bit(tmp_path):
    """torch itself does not notice changed numbers."""
    folder = RunFolder.open(tmp_path / "run", Settings(), "photos")
    folder.save("first_stage", {"values": torch.arange(1000.0)})
    path = tmp_path / "run" / "checkpoint" / "first_stage.pt"
    data = bytearray(path.read_bytes())
    data[data.find(np.float32(500).tobytes())] ^= 16
    path.write_bytes(data)
    torch.load(path, weights_only=True)
    with refused("can't be read"):
        folder.load("first_stage")
    folder.close()


def test_archive_of_a_version_that_is_none(tmp_path):
    Reflections(torch.full((5, 4), 0.5), torch.ones(2, 4, 3)).save(tmp_path / "r.npz")
    data = bytearray((tmp_path / "r.npz").read_bytes())
    data[data.find(b"PK\x01\x02") + 6] = 173
    (tmp_path / "r.npz").write_bytes(data)
    with refused("can't be read"):
        Reflections.load(tmp_path / "r.npz", 4)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x80\x04K\x01r\xff\xff\xff\x7f.", "gives a value the number 2147483647"),  # the memo would become a table of 16 GB
        (b"\x80\x05\x8e\x00\x00\x00\x00\x10\x00\x00\x00abc.", "not a readable pickle"),  # bytes, 64 GB of them announced
        (b"\x80\x05\x96\x00\x00\x00\x00\x10\x00\x00\x00abc.", "not a readable pickle"),  # a bytearray
        (b"\x80\x04(" + b"K\x00" * 3_000_000 + b"l.", "operations"),
    ],
)
def test_pickles_that_claim_more_memory_than_they_have(tmp_path, data, words):
    (tmp_path / "a.pkl").write_bytes(data)
    with refused(words):
        read_pickle(tmp_path / "a.pkl")
    (tmp_path / "b.pkl").write_bytes(pickle.dumps([np.arange(3.0)] * 2000))
    assert len(read_pickle(tmp_path / "b.pkl")) == 2000


def png(width, height, data):
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


@pytest.mark.filterwarnings("ignore:Image size")
def test_images_that_claim_more_than_they_can_hold(tmp_path):
    (tmp_path / "a.png").write_bytes(png(13000, 13000, b""))
    (tmp_path / "b.png").write_bytes(png(4000, 4000, bytes(4000 * (4 * 4000 + 1))))  # black: as small as an image can be
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 17, 8, 13000, 13000, 3) + b"\x01\x11\x00\x02\x11\x00\x03\x11\x00"
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8" + frame + b"\xff\xd9")
    for name in ("a.png", "a.jpg"):
        with refused("far more pixels"):
            image_size(tmp_path / name)
    assert image_size(tmp_path / "b.png") == (4000, 4000)


def test_exr_that_claims_more_than_it_can_hold(tmp_path):
    write_exr(tmp_path / "a.exr", {"Y": np.zeros((8, 8))})
    data = (tmp_path / "a.exr").read_bytes()
    small, large = struct.pack("<4i", 0, 0, 7, 7), struct.pack("<4i", 0, 0, 9999, 9999)
    (tmp_path / "b.exr").write_bytes(data.replace(small, large))
    with refused("far more pixels"):
        exr_size(tmp_path / "b.exr")
    write_exr(tmp_path / "black.exr", {"Y": np.zeros((2000, 2000))})
    assert exr_size(tmp_path / "black.exr") == (2000, 2000)


def saved(folder, name, state):
    run = RunFolder.open(folder / "run", Settings(), "photos")
    run.save(name, state)
    return run


@pytest.mark.parametrize(
    "change",
    [
        {"faces": np.array([[0, 1, 3]])},  # a corner that there is not: compiled code would read beside the array
        {"faces": np.array([[0, 1, -1]])},
        {"faces": np.zeros((0, 3), np.int64)},
        {"faces": np.array([[0.0, 1, 2]])},
        {"normals": np.eye(3)[:2]},
        {"vertices": np.full((3, 3), np.nan)},
        {"voxel": 0.0},
        {"voxel": "x"},
        {"vertices": None},
    ],
)
def test_checkpoint_of_no_surface(tmp_path, change):
    state = Surface(np.eye(3), np.eye(3), np.array([[0, 1, 2]]), 0.1).state()
    with closing(saved(tmp_path, "geometry", state)) as run:
        assert run.load("geometry", Surface.restored).voxel == 0.1
        run.save("geometry", state | change)
        with refused("can't be read"):
            run.load("geometry", Surface.restored)


def test_checkpoint_that_unpacks_to_more_than_it_is(tmp_path):
    with closing(saved(tmp_path, "first_stage", {"values": torch.zeros(10_000)})) as run:
        path = tmp_path / "run" / "checkpoint" / "first_stage.pt"
        with zipfile.ZipFile(path) as archive:
            parts = {entry.filename: archive.read(entry) for entry in archive.infolist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, part in parts.items():
                archive.writestr(name, part)
        with refused("can't be read"):
            run.load("first_stage")


def test_arrays_that_claim_more_than_they_have(tmp_path):
    """numpy allocates what a header claims before it checks whether the file has it."""
    path = tmp_path / "surface_points.npz"
    np.savez_compressed(path, points=np.eye(3, dtype=np.float32), normals=np.asfortranarray(-np.eye(3, dtype=np.float16)))
    position, normal = rendered_points(tmp_path)
    assert np.array_equal(position, np.eye(3)) and np.array_equal(normal, -np.eye(3))
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part.replace(b"(3, 3), }" + b" " * 12, b"(3, 99999999999), }".ljust(21)))
    with refused("can't be read"):
        rendered_points(tmp_path)


def test_array_that_claims_to_be_larger_than_its_file(tmp_path):
    path = tmp_path / "surface_points.npz"
    np.savez(path, points=np.eye(3), normals=np.eye(3))
    data = bytearray(path.read_bytes())
    at = data.find(b"PK\x01\x02")
    data[at + 20 : at + 24] = struct.pack("<I", 0xF0000000)  # its compressed size
    path.write_bytes(data)
    with refused("claims to be larger than the whole"):
        rendered_points(tmp_path)


def test_arrays_that_unpack_to_too_much(tmp_path):
    path = tmp_path / "surface_points.npz"
    np.savez_compressed(path, points=np.zeros((12 << 20, 3), np.float32), normals=np.zeros((1, 3), np.float32))
    assert path.stat().st_size < 1 << 20
    with refused("is too large"):
        rendered_points(tmp_path)


@pytest.mark.parametrize(
    ("points", "normals"),
    [
        (np.eye(3), np.eye(2)),
        (np.eye(3), np.eye(3, dtype=int)),
        (np.eye(3) * np.nan, np.eye(3)),
        (np.zeros((0, 3)), np.zeros((0, 3))),
        (np.array([{}], object), np.eye(3)),
        (np.array(1.0), np.array(1.0)),
    ],
)
def test_points_that_are_none(tmp_path, points, normals):
    np.savez(tmp_path / "surface_points.npz", points=points, normals=normals)
    with refused(r"surface_points\.npz"):
        rendered_points(tmp_path)
