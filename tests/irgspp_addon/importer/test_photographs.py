# SPDX-License-Identifier: GPL-3.0-or-later
"""The quick look at a folder agrees with the engine on what needs cameras."""

from pathlib import Path

import pytest
from irgspp.core.capture.photograph_files import PHOTOGRAPHS as ENGINE_PHOTOGRAPHS
from irgspp.core.capture.photograph_files import RAW as ENGINE_RAW
from irgspp.core.capture.photograph_files import VIDEOS as ENGINE_VIDEOS
from irgspp.core.capture.photograph_files import find_photographs
from irgspp.irgspp_addon.importer import photographs
from irgspp.irgspp_addon.importer.photographs import PHOTOGRAPHS, RAW, BarePhotographs, find_bare_photographs
from irgspp.irgspp_addon.properties import VIDEOS


def write(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


def test_suffixes_are_the_engines():
    assert (PHOTOGRAPHS, RAW, VIDEOS) == (ENGINE_PHOTOGRAPHS, ENGINE_RAW, ENGINE_VIDEOS)


def test_photographs_are_counted_as_the_engine_counts_them(tmp_path):
    write(
        tmp_path,
        "a.JPG",
        "a.dng",
        "b.heic",
        "sub/c.png",
        "sub/turn.mp4",
        "b.mov",
        ".hidden/d.jpg",
        ".e.jpg",
        "masks/a.png",
        "masks_b/a.png",
        "notes.txt",
    )
    write(tmp_path, "sub/mine/photographs.json", "sub/mine/images/a.jpg")  # a capture of some of them
    assert find_bare_photographs(tmp_path) == BarePhotographs(3, 1)
    found = find_photographs(tmp_path)
    assert (len(found.photographs), len(found.videos)) == (3, 1)


def test_a_video_a_text_and_nothing(tmp_path):
    write(tmp_path, "turn.MP4", "notes.txt", "empty/notes.txt")
    assert find_bare_photographs(tmp_path / "turn.MP4") == BarePhotographs(0, 1)
    for path in (tmp_path / "notes.txt", tmp_path / "empty", tmp_path / "no"):
        assert find_bare_photographs(path) is None


@pytest.mark.parametrize(
    "files",
    [
        ["capture.json"],
        ["transforms.json"],
        ["transforms_train.json"],
        ["sparse/0/cameras.bin", "sparse/0/images.bin"],
        ["cameras.txt", "images.txt"],
        ["colmap/sparse/0/cameras.bin", "colmap/sparse/0/images.bin"],
        ["train_000/metadata.json"],
        ["0-camera.pkl"],
    ],
)
def test_descriptions_of_cameras_are_known(tmp_path, files):
    write(tmp_path, "images/a.jpg", *files)
    assert find_bare_photographs(tmp_path) is None


def test_cameras_of_other_programs_are_known_by_their_heads(tmp_path):
    write(tmp_path, "a.jpg")
    (tmp_path / "other.xml").write_text("<svg/>")
    (tmp_path / "table.csv").write_text("a,b\n")
    assert find_bare_photographs(tmp_path) == BarePhotographs(1, 0)
    (tmp_path / "cameras.xml").write_text('<?xml version="1.0"?>\n<document version="2.0"><chunk/></document>')
    assert find_bare_photographs(tmp_path) is None
    (tmp_path / "cameras.xml").unlink()
    (tmp_path / "table.csv").write_text("#name,x,y,alt,heading,pitch,roll,f\n")
    assert find_bare_photographs(tmp_path) is None


def test_a_huge_folder_is_not_read_to_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr(photographs, "LOOKED_AT", 3)
    write(tmp_path, *(f"{i}.jpg" for i in range(5)))
    assert find_bare_photographs(tmp_path) == BarePhotographs(3, 0, complete=False)
