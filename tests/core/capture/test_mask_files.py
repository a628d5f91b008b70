# SPDX-License-Identifier: GPL-3.0-or-later
"""Mask files of common tools are found for the photographs that they belong to."""

import os

import pytest
from irgspp.core.capture.mask_files import find_masks, mask_key
from refused import refused


def found(folder, photograph, masks):
    for name in (photograph, *masks):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")
    file = find_masks(folder).get(mask_key(folder / photograph, folder))
    return file and file.relative_to(folder.parent).as_posix()


@pytest.mark.parametrize(
    ("photograph", "mask"),
    [
        ("a.jpg", "masks/a.png"),
        ("a.jpg", "masks/a.jpg.png"),
        ("a.HEIC", "mask/a.HEIC.png"),
        ("a.jpg", "masks/a_mask.png"),
        ("a.jpg", "masks_manual/a.tif"),
        ("a.jpg", "a_mask.png"),
        ("a.jpg", "a.jpg_mask.png"),
        ("ring/a.b.jpg", "masks/ring/a.b.png"),
        ("ring/a.jpg", "ring/masks/a.png"),
        ("ring/a.jpg", "ring/a_mask.png"),
        ("images/ring/a.jpg", "masks/ring/a.png"),
        ("images_4/a.jpg", "masks_4/a.png"),
        ("photos/a.jpg", "masks/photos/a.png"),
    ],
)
def test_naming(tmp_path, photograph, mask):
    assert found(tmp_path / "set", photograph, [mask]) == f"set/{mask}"


@pytest.mark.parametrize("beside", ["masks/a.png", "masks/a.jpg.png", "images_masks/a.png", "images_mask/a.png"])
def test_masks_beside_the_folder(tmp_path, beside):
    (tmp_path / beside).parent.mkdir()
    (tmp_path / beside).write_bytes(b"x")
    assert found(tmp_path / "images", "a.jpg", []) == beside


@pytest.mark.parametrize(
    ("photograph", "mask"), [("a.jpg", "masks/b.png"), ("one/a.jpg", "masks/a.png"), ("images_4/a.jpg", "masks_8/a.png")]
)
def test_masks_of_others(tmp_path, photograph, mask):
    assert found(tmp_path / "set", photograph, [mask]) is None


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_link_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "set/masks").mkdir(parents=True)
    (tmp_path / "secret.png").write_bytes(b"x")
    (tmp_path / "set/masks/a.png").symlink_to("../../secret.png")
    with refused("leads out"):
        find_masks(tmp_path / "set")
