# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a capture are found in natural order; masks, copies, RAW twins and live photographs are none of them."""

import os

import pytest
from irgspp.core.capture.photograph_files import find_photographs, has_photographs
from refused import refused


def made(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")
    return folder


def relative(files, root):
    return [f.relative_to(root).as_posix() for f in files]


def test_photographs_are_found_below_the_folder_in_natural_order(tmp_path):
    made(
        tmp_path,
        "IMG_10.JPG",
        "IMG_2.jpeg",
        "b/1.png",
        "a/x.HEIC",
        "a/y.tif",
        "z.webp",
        "r.NEF",
        "notes.txt",
        ".hidden.jpg",
        ".trash/a.jpg",
    )
    found = find_photographs(tmp_path)
    assert relative(found.photographs, tmp_path) == ["IMG_2.jpeg", "IMG_10.JPG", "a/x.HEIC", "a/y.tif", "b/1.png", "r.NEF", "z.webp"]
    assert not found.videos and not found.notes and found.root == tmp_path


def test_masks_are_no_photographs(tmp_path):
    made(tmp_path, "a.jpg", "a_mask.png", "a.jpg_mask.png", "masks/a.png", "Mask/a.png", "masks_2/a.png", "gas_mask.jpg")
    assert relative(find_photographs(tmp_path).photographs, tmp_path) == ["a.jpg", "gas_mask.jpg"]


def test_one_of_raw_and_developed_photograph_is_used(tmp_path):
    made(tmp_path, "a.CR2", "a.jpg", "b.CR2", "other/a.dng")
    found = find_photographs(tmp_path)
    assert relative(found.photographs, tmp_path) == ["a.jpg", "b.CR2", "other/a.dng"]
    assert found.notes == ["1 RAW files next to developed photographs of the same name are not used, such as a.CR2"]


def test_video_of_a_live_photograph_is_not_used(tmp_path):
    made(tmp_path, "IMG_1.HEIC", "IMG_1.MOV", "IMG_2.mov", "IMG_3.mp4")
    found = find_photographs(tmp_path)
    assert relative(found.videos, tmp_path) == ["IMG_2.mov", "IMG_3.mp4"] and len(found.photographs) == 1
    assert "live photographs" in found.notes[0] and "IMG_1.MOV" in found.notes[0]


def test_copies_of_an_earlier_reading_are_no_photographs(tmp_path):
    made(tmp_path, "a.jpg", "run/photographs.json", "run/photographs/a.jpg", "run/given_masks/a.png", "run/deeper/a.jpg")
    assert relative(find_photographs(tmp_path).photographs, tmp_path) == ["a.jpg"]
    made(tmp_path, "photographs.json", "photographs/b.jpg")
    assert relative(find_photographs(tmp_path).photographs, tmp_path) == ["a.jpg"]


def test_single_video(tmp_path):
    made(tmp_path, "walk.MP4", "other.jpg")
    found = find_photographs(tmp_path / "walk.MP4")
    assert found.videos == [tmp_path / "walk.MP4"] and not found.photographs and found.root == tmp_path


def test_nothing_to_read_is_refused(tmp_path):
    with refused("no photographs and no video", "jpg", "mp4"):
        find_photographs(made(tmp_path, "notes.txt"))
    with refused("single file but not a video"):
        find_photographs(tmp_path / "notes.txt")
    with refused("does not exist"):
        find_photographs(tmp_path / "gone")


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_link_out_of_the_folder_is_refused(tmp_path):
    made(tmp_path, "in/a.jpg", "in/sub/b.jpg", "out/secret.jpg")
    (tmp_path / "in/same.jpg").symlink_to("sub/b.jpg")
    assert len(find_photographs(tmp_path / "in").photographs) == 3
    (tmp_path / "in/way.jpg").symlink_to("../out/secret.jpg")
    with refused("leads out"):
        find_photographs(tmp_path / "in")
    (tmp_path / "in/way.jpg").unlink()
    (tmp_path / "in/circle.jpg").symlink_to("circle.jpg")
    with refused("impossible file"):
        find_photographs(tmp_path / "in")


def test_has_photographs(tmp_path):
    assert not has_photographs(tmp_path) and not has_photographs(tmp_path / "gone")
    made(tmp_path, "notes.txt", "masks/a.png")
    assert not has_photographs(tmp_path) and not has_photographs(tmp_path / "notes.txt")
    made(tmp_path, "a/b/c.heic", "v/x.webm")
    assert has_photographs(tmp_path) and has_photographs(tmp_path / "v") and has_photographs(tmp_path / "v/x.webm")
    assert not has_photographs(tmp_path / "a/b/c.heic")


def test_has_photographs_gives_up_on_large_folders(tmp_path, monkeypatch):
    monkeypatch.setattr("irgspp.core.capture.photograph_files.MAX_LOOKED_AT", 5)
    made(tmp_path, *(f"{i}.txt" for i in range(10)), "z.jpg")
    assert not has_photographs(tmp_path)
