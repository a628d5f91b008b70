# SPDX-License-Identifier: GPL-3.0-or-later
"""Datasets made to do harm are refused in one line: pickles that run code, bombs, ways and links out of the folder."""

import io
import json
import os
import pickle
import shutil
import struct
import zlib

import numpy as np
import OpenEXR
import pytest
from irgspp.core.config import DataSettings
from irgspp.core.datasets.detect import read_capture
from irgspp.core.datasets.layers import layers_of
from irgspp.core.datasets.load import load_dataset
from irgspp.core.datasets.pickles import read_pickle
from irgspp.core.datasets.picture import picture_size, read_depth_mask, read_mask, read_picture
from irgspp.core.errors import InputError
from irgspp.core.evaluation.truth import load_scene_truth, load_truth
from irgspp.core.scene.exr import read_exr, read_exr_rgb
from irgspp.core.scene.light_files import read_light
from PIL import Image


def refused(*words):
    return pytest.raises(InputError, match="".join(f"(?=.*{w})" for w in words))


class Runs:
    """Unpickled by the standard library, it makes a file."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return os.mkdir, (self.marker,)


@pytest.mark.parametrize("protocol", range(6))
def test_pickled_arrays_are_read_whatever_the_protocol(tmp_path, protocol):
    whole = [np.arange(12.0).reshape(3, 4), np.asfortranarray(np.arange(6, dtype="<f4").reshape(2, 3)), {1: "a", 2: np.int64(3)}]
    whole += [np.array(["0", "127"]), np.array(5, ">i2"), (True, None, 2.5, b"x"), np.zeros((0, 3))]
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(whole, protocol))
    read = read_pickle(path)
    assert read[2] == {1: "a", 2: 3} and read[5] == whole[5]
    for i in (0, 1, 3, 4, 6):
        assert read[i].dtype == whole[i].dtype and np.array_equal(read[i], whole[i])


def test_pickles_that_run_code_are_refused_and_don_t(tmp_path):
    path, marker = tmp_path / "a.pkl", tmp_path / "ran"
    pickle.loads(pickle.dumps(Runs(marker)))  # it does
    marker.rmdir()
    harm = [Runs(marker), [np.eye(3), Runs(marker)], {"a": (Runs(marker),)}, np.array([Runs(marker)], object)]
    for value in harm:
        for protocol in (0, 2, 4, 5):
            path.write_bytes(pickle.dumps(value, protocol))
            with refused(r"a\.pkl", "refused"):
                read_pickle(path)
            assert not marker.exists()


@pytest.mark.parametrize(
    "data",
    [
        b"cos\nsystem\n(S'true'\ntR.",
        b"cbuiltins\neval\n(S'1'\ntR.",
        b"cnumpy.testing._private.utils\nrunstring\n(S'1'\nd(tR.",
        b"\x80\x04\x8c\x05numpy\x8c\x04load\x93\x8c\x05a.npy\x85R.",
        b"\x80\x04\x8c\x05numpy\x8c\x07ndarray\x93.",
        b"c__main__\nx\n.",
        pickle.dumps({1, 2}),
        pickle.dumps(np.zeros(2, "M8[s]")),
        pickle.dumps(np.zeros(2, [("a", "f4")])),
        pickle.dumps(io.BytesIO),
        pickle.dumps(np.eye(4))[:-40],
        b"",
        b"no pickle at all",
        pickle.dumps(np.eye(4)).replace(b"\x93", b"\x00", 1),
    ],
)
def test_pickles_of_anything_else_are_bad_input(tmp_path, data):
    path = tmp_path / "a.pkl"
    path.write_bytes(data)
    with refused(r"a\.pkl"):
        read_pickle(path)


def test_pickles_that_swell_are_refused(tmp_path):
    path, value = tmp_path / "a.pkl", []
    for _ in range(6):
        value = [value] * 100
    path.write_bytes(pickle.dumps(value))
    with refused("more than"):
        read_pickle(path)


def glossy_scene(folder, count=3):
    for i in range(count):
        camera = [np.array([[1.0, 0, 0, 0.1 * i], [0, 1, 0, 0], [0, 0, 1, 4]]), np.array([[50.0, 0, 16], [0, 50, 16], [0, 0, 1]])]
        (folder / f"{i}-camera.pkl").write_bytes(pickle.dumps(camera))
        Image.new("RGB", (32, 32), (90, 90, 90)).save(folder / f"{i}.png")
    return folder


def test_a_dataset_with_such_a_pickle_is_refused(tmp_path):
    scene, marker = glossy_scene(tmp_path), tmp_path / "ran"
    assert read_capture(scene, DataSettings()).format == "glossy-synthetic"
    (scene / "1-camera.pkl").write_bytes(pickle.dumps(Runs(marker)))
    with refused(r"1-camera\.pkl", "mkdir", "refused"):
        load_dataset(scene)
    for other in ([np.eye(3), np.eye(3)], np.eye(4), [np.eye(3, 4), np.full((3, 3), "1")], [np.full((3, 4), np.nan), np.eye(3)]):
        (scene / "1-camera.pkl").write_bytes(pickle.dumps(other))
        with refused(r"1-camera\.pkl"):
            load_dataset(scene)
    assert not marker.exists()


def png_bomb(side=60_000):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 16, 6, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"\0" * 10_000)) + chunk(b"IEND", b"")


def exr_bomb(path, side=60_000):
    """A small EXR whose header claims to be large."""
    pixels = {c: np.zeros((8, 8), np.float32) for c in "RGB"}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, pixels).write(str(path))
    data = path.read_bytes()
    box = struct.pack("<4i", 0, 0, 7, 7)
    assert data.count(box) == 2
    path.write_bytes(data.replace(box, struct.pack("<4i", 0, 0, side - 1, side - 1)))


def test_enormous_pictures_are_refused_before_they_are_decoded(tmp_path):
    (tmp_path / "a.png").write_bytes(png_bomb())
    exr_bomb(tmp_path / "a.exr")
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n" + b"\2\2\0\0" * 100)
    for read in (picture_size, read_picture, read_mask, lambda p: read_depth_mask(p, 0.5), read_light):
        for name in ("a.png", "a.exr"):
            with refused(name, "60000x60000", "million"):
                read(tmp_path / name)
    for read in (read_exr, read_exr_rgb):
        with refused(r"a\.exr", "60000x60000"):
            read(tmp_path / "a.exr")
    with refused(r"a\.hdr", "60000x60000"):
        read_light(tmp_path / "a.hdr")


def test_a_bomb_among_photographs_is_left_out_and_told(capture):
    capture.transforms()
    (capture.folder / "images/003.png").write_bytes(png_bomb())
    data = load_dataset(capture.folder)
    assert len(data.train) == 7 and any("003.png" in w and "60000x60000" in w for w in data.warnings)


def arrays(path, value):
    np.save(path, value)
    return path


def test_arrays_that_lie_or_hold_objects_are_refused(tmp_path, capture):
    scene = tmp_path / "blender_LDR" / "thing"
    truth = tmp_path / "ground_truth" / "thing" / "z_depth"
    truth.mkdir(parents=True)
    (scene / "test").mkdir(parents=True)
    Image.new("RGB", (8, 8)).save(scene / "test" / "0000.png")
    capture.transforms()
    view = load_dataset(capture.folder).train[0]
    view = type(view)(view.name, view.camera, scene / "test" / "0000.png", view.colour, None)
    path = arrays(truth / "0000.npy", np.ones((8, 8), np.float32))
    assert layers_of("stanford-orb", view).depth.shape == (8, 8)
    whole = path.read_bytes()
    for data in (
        pickle.dumps(1),
        whole[:100],
        b"",
        whole.replace(b"(8, 8), }" + 8 * b" ", b"(99999, 99999), }"),
        whole.replace(b"}", b" "),
    ):
        path.write_bytes(data)
        with refused(r"0000\.npy"):
            layers_of("stanford-orb", view)
    for value in (np.array([{}], object), np.zeros((2, 2), int), np.zeros((2, 2, 2, 2)), np.zeros((4, 4, 7))):
        np.save(path, value, allow_pickle=True)
        with refused(r"0000\.npy"):
            layers_of("stanford-orb", view)


WAYS_OUT = ["../secret.png", "images/../../secret.png", "..\\secret.png", "a/../../secret", "{outside}/secret.png", "../gone.png"]


@pytest.fixture
def trapped(capture, tmp_path_factory):
    """A capture in a folder of its own, with a picture beside that folder that is none of its business."""
    home = tmp_path_factory.mktemp("home")
    capture.folder = home / "dataset"
    capture.folder.mkdir()
    Image.fromarray(capture.pictures[0]).save(home / "secret.png")
    return capture


@pytest.mark.parametrize("way", WAYS_OUT)
@pytest.mark.parametrize("key", ["file_path", "mask_path", "ply_file_path"])
def test_ways_out_of_the_folder_in_transforms(trapped, way, key):
    path = trapped.transforms()
    name = way.format(outside=trapped.folder.parent)
    trapped.edit(path, lambda c: (c if key == "ply_file_path" else c["frames"][2]).update({key: name}))
    with refused("leads out"):
        load_dataset(trapped.folder)


def test_ways_inside_the_folder_are_kept(trapped):
    path = trapped.transforms()
    trapped.edit(path, lambda c: c["frames"][2].update(file_path="images/../images/002.png"))
    trapped.edit(path, lambda c: c["frames"][3].update(file_path=str(trapped.folder / "images/003.png")))
    (trapped.folder / "images/004.png").rename(trapped.folder / "real.png")
    (trapped.folder / "images/004.png").symlink_to("../real.png")
    assert len(load_dataset(trapped.folder, DataSettings(holdout=0)).train) == 10
    link = trapped.folder.parent / "link"
    link.symlink_to(trapped.folder, target_is_directory=True)
    assert len(load_dataset(link, DataSettings(holdout=0)).train) == 10


@pytest.mark.parametrize("binary", [True, False])
def test_ways_out_of_the_folder_in_colmap(trapped, binary):
    names = [f"{i:03d}.png" for i in range(10)]
    trapped.colmap(binary, names=names)
    file = trapped.folder / "sparse/0" / ("images.bin" if binary else "images.txt")
    data = file.read_bytes()
    longer = b"../../secret.png"
    file.write_bytes(data.replace(b"003.png", longer, 1))
    with refused("leads out", "secret"):
        load_dataset(trapped.folder)


@pytest.mark.parametrize("what", ["picture", "folder", "mask", "loop"])
@pytest.mark.parametrize("form", ["transforms", "colmap"])
def test_links_out_of_the_folder(trapped, what, form):
    trapped.transforms() if form == "transforms" else trapped.colmap(True)
    picture = trapped.folder / "images/003.png"
    if what == "folder":
        shutil.move(trapped.folder / "images", trapped.folder.parent / "images")
        (trapped.folder / "images").symlink_to(trapped.folder.parent / "images", target_is_directory=True)
    elif what == "mask":
        (trapped.folder / "masks").mkdir()
        (trapped.folder / "masks/003.png").symlink_to(trapped.folder.parent / "secret.png")
    else:
        picture.unlink()
        picture.symlink_to(trapped.folder.parent / "secret.png" if what == "picture" else picture)
    with refused(r"003\.png" if what != "folder" else "images", "impossible file" if what == "loop" else "leads out"):
        load_dataset(trapped.folder)


def tensoir_scene(folder):
    for split in ("train", "test"):
        for i in range(3):
            view = folder / f"{split}_{i:03d}"
            view.mkdir(parents=True)
            pose = np.eye(4)
            pose[:3, 3] = 0.1 * i, 0, 4
            matrix = ",".join(map(str, pose.reshape(-1)))
            (view / "metadata.json").write_text(json.dumps({"cam_transform_mat": matrix, "cam_angle_x": 0.7, "imw": 16, "imh": 16}))
            for name in ("rgba", "albedo", "normal", "rgba_city"):
                Image.new("RGBA", (16, 16), (90, 90, 200, 255)).save(view / f"{name}.png")
    return folder


@pytest.mark.parametrize("name", ["rgba", "albedo", "normal", "rgba_city"])
def test_links_out_of_the_folder_among_truth(tmp_path, name):
    scene = tensoir_scene(tmp_path / "scene")
    Image.new("RGBA", (16, 16)).save(tmp_path / "secret.png")
    file = scene / "test_001" / f"{name}.png"
    file.unlink()
    file.symlink_to(tmp_path / "secret.png")
    with refused("leads out", name):
        data = load_dataset(scene)
        truth = load_scene_truth(scene, data.to_world)
        for view in data.test:
            load_truth(view, truth, data.to_world)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.update(cam_transform_mat="1,2,3"), ["16"]),
        (lambda m: m.update(cam_transform_mat="a," * 16), ["metadata"]),
        (lambda m: m.pop("imw"), ["imw"]),
        (lambda m: m.update(imw=-3), ["size"]),
        (lambda m: m.update(cam_angle_x="wide"), ["number"]),
        (lambda m: m.update(cam_transform_mat=",".join(["nan"] * 16)), ["not finite"]),
    ],
)
def test_damaged_descriptions_of_tensoir(tmp_path, change, words):
    scene = tensoir_scene(tmp_path)
    file = scene / "train_001" / "metadata.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    with refused(r"train_001.metadata\.json", *words):
        load_dataset(scene)


@pytest.mark.parametrize("scene", ["../..", "..", "a/b", "", None, 7, "/etc", "a\\b"])
def test_captures_of_other_scenes_lie_beside(trapped, scene):
    path = trapped.transforms("transforms_train.json", [f"train/{i:04d}" for i in range(10)], **trapped.angle)
    content = json.loads(path.read_text())
    content["frames"] = [{**content["frames"][0], "scene_name": scene, "camera_angle_x": 0.7}]
    (trapped.folder / "transforms_novel.json").write_text(json.dumps(content))
    with refused("is not the name of a folder"):
        load_dataset(trapped.folder)


XML = """<?xml version="1.0" encoding="UTF-8"?>{doctype}
<document version="2.0.0"><chunk label="c"><sensors><sensor id="0" label="s" type="frame"><resolution width="60" height="48"/>
<calibration type="frame" class="adjusted"><f>70</f>{extra}</calibration></sensor></sensors>
<cameras>{cameras}</cameras></chunk></document>"""
POSE = "1 0 0 {i} 0 1 0 0 0 0 1 0 0 0 0 1"


def metashape(folder, doctype="", extra="", label="{i:03d}", pose=POSE):
    cameras = "".join(
        f'<camera id="{i}" sensor_id="0" label="{label.format(i=i)}"><transform>{pose.format(i=i)}</transform></camera>' for i in range(10)
    )
    (folder / "cameras.xml").write_text(XML.format(doctype=doctype, extra=extra, cameras=cameras))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (dict(doctype='<!DOCTYPE d [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'), ["entities"]),
        (dict(doctype='<!DOCTYPE d [<!ENTITY x SYSTEM "file:///etc/passwd">]>'), ["entities"]),
        (dict(label="../secret"), ["leads out"]),
        (dict(label="{{outside}}/secret"), ["leads out"]),
        (dict(extra="<k4>0.1</k4>"), ["k4"]),
        (dict(extra="<b2>40</b2>"), ["skew"]),
        (dict(extra="<k1>nan</k1>"), ["k1", "number"]),
        (dict(pose="1 2 3"), ["3 numbers"]),
        (dict(pose="2 0 0 {i} 0 1 0 0 0 0 1 0 0 0 0 1"), ["not rigid"]),
    ],
)
def test_hostile_and_damaged_cameras_of_metashape(trapped, given, words):
    trapped.save_pictures([f"images/{i:03d}.png" for i in range(10)])
    metashape(trapped.folder)
    assert read_capture(trapped.folder, DataSettings()).format == "metashape"
    given = {k: v.replace("{{outside}}", str(trapped.folder.parent)) for k, v in given.items()}
    metashape(trapped.folder, **given)
    with refused(*words):
        load_dataset(trapped.folder)


HEAD = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("../secret.png,0,0,0,0,0,0,40,0,0,0,0,0,0,0,0", ["leads out"]),
        ("003.png,0,0,0,0,0,0,40,0,0,0,0,0,0.1,0,0", ["k4"]),
        ("003.png,0,0,0,0,0,0,wide,0,0,0,0,0,0,0,0", ["f is not a number"]),
        ("003.png,0,nan,0,0,0,0,40,0,0,0,0,0,0,0,0", ["y is not a number"]),
        ("x" * 200_000 + ",0,0,0,0,0,0,40", ["no table"]),
        ("003.png,1e30,0,0,0,0,0,40,0,0,0,0,0,0,0,0", ["infinity"]),
        ("003.png,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0", ["focal"]),
    ],
)
def test_hostile_and_damaged_cameras_of_realitycapture(trapped, row, words):
    trapped.save_pictures([f"images/{i:03d}.png" for i in range(10)])
    rows = [f"{i:03d}.png,{i},0,0,{20 * i},40,0,40,0,0,0,0,0,0,0,0" for i in range(10)]
    file = trapped.folder / "cameras.csv"
    file.write_text("\n".join(["#cameras 10", HEAD, *rows]))
    assert read_capture(trapped.folder, DataSettings()).format == "realitycapture"
    file.write_text("\n".join([HEAD, *rows[:3], row, *rows[4:]]))
    with refused(*words):
        load_dataset(trapped.folder)


def test_sensors_of_metashape(trapped):
    """A fisheye and a frame camera, one sensor never calibrated, one camera switched off."""
    trapped.save_pictures([f"images/{i:03d}.png" for i in range(10)])
    metashape(trapped.folder)
    file = trapped.folder / "cameras.xml"
    fisheye = """<sensor id="1" label="f" type="fisheye"><resolution width="60" height="48"/><calibration type="fisheye" class="initial">
        <f>30</f></calibration><calibration type="fisheye" class="adjusted"><f>31</f><cx>0.5</cx><cy>-1</cy><k1>0.01</k1><k4>0.002</k4>
        <b1>2</b1></calibration></sensor><sensor id="2" label="n" type="frame"><resolution width="60" height="48"/></sensor></sensors>"""
    text = file.read_text().replace("</sensors>", fisheye)
    text = text.replace('id="3" sensor_id="0"', 'id="3" sensor_id="1"').replace('id="4" sensor_id="0"', 'id="4" sensor_id="2"')
    file.write_text(text.replace('id="5" sensor_id="0"', 'id="5" sensor_id="0" enabled="false"'))
    capture = read_capture(trapped.folder, DataSettings())
    lenses = {f.listed: f.lens for f in capture.train}
    assert sorted(lenses) == [f"{i:03d}" for i in range(10) if i not in (4, 5)] and "2 cameras" in capture.warnings[0]
    one = lenses["003"]
    assert one.fisheye and (one.fx, one.fy, one.cx, one.cy) == (33, 31, 30.5, 23) and one.distortion == (0.01, 0, 0, 0.002)
    assert not lenses["000"].distorted and (lenses["000"].fx, lenses["000"].cx) == (70, 30)


def test_capture_of_realitycapture_with_a_semicolon(trapped):
    trapped.save_pictures([f"{i:03d}.png" for i in range(10)])
    rows = [f"{i:03d};{i};0;0;{20 * i};40;0;40;0.01;-0.02;0;0;0;0;0;0" for i in range(10)]  # names without extension, pictures beside
    (trapped.folder / "cameras.csv").write_text("\n".join([HEAD.replace(",", ";"), *rows]))
    capture = read_capture(trapped.folder, DataSettings())
    lens = capture.train[0].lens
    assert len(capture.train) == 10 and np.allclose((lens.fx, lens.cx, lens.cy), (40 / 36 * 60, 30.6, 22.8))
