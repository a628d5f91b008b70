# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways and links out of a dataset's folder are refused in one line, those inside it are followed."""

import json
import shutil

import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.settings.schema import DataSettings
from refused import refused

WAYS_OUT = ["../secret.png", "images/../../secret.png", "..\\secret.png", "a/../../secret", "{outside}/secret.png", "../gone.png"]


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
    image = trapped.folder / "images/003.png"
    if what == "folder":
        shutil.move(trapped.folder / "images", trapped.folder.parent / "images")
        (trapped.folder / "images").symlink_to(trapped.folder.parent / "images", target_is_directory=True)
    elif what == "mask":
        (trapped.folder / "masks").mkdir()
        (trapped.folder / "masks/003.png").symlink_to(trapped.folder.parent / "secret.png")
    else:
        image.unlink()
        image.symlink_to(trapped.folder.parent / "secret.png" if what == "picture" else image)
    leads = ["impossible file"] if what == "loop" else ["leads out", f"to {trapped.folder.parent.resolve()}", "copy"]
    with refused(r"003\.png" if what != "folder" else "images", *leads):
        load_dataset(trapped.folder)


@pytest.mark.parametrize("scene", ["../..", "..", "a/b", "", None, 7, "/etc", "a\\b"])
def test_captures_of_other_scenes_lie_beside(trapped, scene):
    path = trapped.transforms("transforms_train.json", [f"train/{i:04d}" for i in range(10)], **trapped.angle)
    content = json.loads(path.read_text())
    content["frames"] = [{**content["frames"][0], "scene_name": scene, "camera_angle_x": 0.7}]
    (trapped.folder / "transforms_novel.json").write_text(json.dumps(content))
    with refused("is not the name of a folder"):
        load_dataset(trapped.folder)
