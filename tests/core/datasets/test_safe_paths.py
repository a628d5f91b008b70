# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths and links out of a dataset's folder are refused in one line; those inside of it are followed."""

import json
import shutil

import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.settings.schema import DataSettings
from refused import refused

WAYS_OUT = ["../secret.png", "images/../../secret.png", "..\\secret.png", "a/../../secret", "{outside}/secret.png", "../gone.png"]


@pytest.mark.parametrize("way", WAYS_OUT)
@pytest.mark.parametrize("key", ["file_path", "mask_path", "ply_file_path"])
def test_ways_out_of_the_folder_in_transforms(confined_dataset, way, key):
    path = confined_dataset.transforms()
    name = way.format(outside=confined_dataset.folder.parent)
    confined_dataset.edit(path, lambda c: (c if key == "ply_file_path" else c["frames"][2]).update({key: name}))
    with refused("leads out"):
        load_dataset(confined_dataset.folder)


def test_ways_inside_the_folder_are_kept(confined_dataset):
    path = confined_dataset.transforms()
    confined_dataset.edit(path, lambda c: c["frames"][2].update(file_path="images/../images/002.png"))
    confined_dataset.edit(path, lambda c: c["frames"][3].update(file_path=str(confined_dataset.folder / "images/003.png")))
    (confined_dataset.folder / "images/004.png").rename(confined_dataset.folder / "real.png")
    (confined_dataset.folder / "images/004.png").symlink_to("../real.png")
    assert len(load_dataset(confined_dataset.folder, DataSettings(holdout=0)).train) == 10
    link = confined_dataset.folder.parent / "link"
    link.symlink_to(confined_dataset.folder, target_is_directory=True)
    assert len(load_dataset(link, DataSettings(holdout=0)).train) == 10


@pytest.mark.parametrize("binary", [True, False])
def test_ways_out_of_the_folder_in_colmap(confined_dataset, binary):
    names = [f"{i:03d}.png" for i in range(10)]
    confined_dataset.colmap(binary, names=names)
    file = confined_dataset.folder / "sparse/0" / ("images.bin" if binary else "images.txt")
    data = file.read_bytes()
    longer = b"../../secret.png"
    file.write_bytes(data.replace(b"003.png", longer, 1))
    with refused("leads out", "secret"):
        load_dataset(confined_dataset.folder)


@pytest.mark.parametrize("what", ["image", "folder", "mask", "loop"])
@pytest.mark.parametrize("form", ["transforms", "colmap"])
def test_links_out_of_the_folder(confined_dataset, what, form):
    confined_dataset.transforms() if form == "transforms" else confined_dataset.colmap(True)
    image = confined_dataset.folder / "images/003.png"
    if what == "folder":
        shutil.move(confined_dataset.folder / "images", confined_dataset.folder.parent / "images")
        (confined_dataset.folder / "images").symlink_to(confined_dataset.folder.parent / "images", target_is_directory=True)
    elif what == "mask":
        (confined_dataset.folder / "masks").mkdir()
        (confined_dataset.folder / "masks/003.png").symlink_to(confined_dataset.folder.parent / "secret.png")
    else:
        image.unlink()
        image.symlink_to(confined_dataset.folder.parent / "secret.png" if what == "image" else image)
    leads = ["impossible file"] if what == "loop" else ["leads out", f"to {confined_dataset.folder.parent.resolve()}", "copy"]
    with refused(r"003\.png" if what != "folder" else "images", *leads):
        load_dataset(confined_dataset.folder)


@pytest.mark.parametrize("scene", ["../..", "..", "a/b", "", None, 7, "/etc", "a\\b"])
def test_names_of_other_scenes_are_single_folders(confined_dataset, scene):
    path = confined_dataset.transforms("transforms_train.json", [f"train/{i:04d}" for i in range(10)], **confined_dataset.angle)
    content = json.loads(path.read_text())
    content["frames"] = [{**content["frames"][0], "scene_name": scene, "camera_angle_x": 0.7}]
    (confined_dataset.folder / "transforms_novel.json").write_text(json.dumps(content))
    with refused("is not the name of a folder"):
        load_dataset(confined_dataset.folder)
