# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture becomes upright copies with masks; it is resumed, cancelled and never written to."""

import json
import os
import shutil

import cv2
import numpy as np
import pytest
from irgspp.core.capture import copies, reading
from irgspp.core.capture.exif import EXPOSURE_TIME, F_NUMBER, FOCAL_35, ISO, MODEL, ORIENTATION
from irgspp.core.capture.photograph import LeftOut
from irgspp.core.capture.reading import read_photographs
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import CaptureSettings
from PIL import Image
from refused import refused

SETTINGS = CaptureSettings(frames=5)


def read(photos, out, progress=Silent()):  # noqa: B008
    return read_photographs(photos, out, SETTINGS, progress)


def content(folder):
    """Bytes and time of change of each file."""
    return {p.relative_to(folder).as_posix(): (p.read_bytes(), p.stat().st_mtime_ns) for p in sorted(folder.rglob("*")) if p.is_file()}


def test_mixed_capture(tmp_path, write_views, views, writers, exif):
    photos, out = write_views(4), tmp_path / "out"
    shot = exif({ORIENTATION: 6, MODEL: "phone"}, {FOCAL_35: 30, EXPOSURE_TIME: 0.01, F_NUMBER: 2, ISO: 100})
    Image.fromarray(views(10)).save(photos / "IMG_11.jpg", exif=shot, quality=95, subsampling=0)
    Image.fromarray(views(11)).save(photos / "b.png")
    writers.write_dng(photos / "c.dng", views(12) / 255)
    writers.write_video(photos / "walk.mp4", [np.roll(views(13), 8 * i, 1) for i in range(10)])
    before = content(photos)
    photographs, left_out = read(photos, out)
    assert content(photos) == before and not left_out
    frames = [p for p in photographs if p.source.suffix == ".mp4"]
    names = [p.name for p in photographs[: -len(frames)]]
    assert names == ["IMG_1", "IMG_2", "IMG_3", "IMG_4", "IMG_11", "b", "c"] and len(frames) == 5
    assert [p.name for p in frames] == sorted(p.name for p in frames) and frames[0].name.startswith("walk_f00000")
    assert [p.image.suffix for p in photographs] == [".jpg"] * 5 + [".png"] * 2 + [".jpg"] * 5
    for p in photographs:
        with Image.open(p.image) as image:
            assert image.size == (p.width, p.height) and image.getexif().get(ORIENTATION, 1) == 1
    assert (out / "photographs/IMG_1.jpg").read_bytes() == (photos / "IMG_1.jpg").read_bytes()
    turned = photographs[4]
    assert (turned.width, turned.height, turned.turned) == (96, 128, 3) and turned.lens == "|phone|||128x96|portrait"
    assert turned.focal == pytest.approx(30 * 160 / np.hypot(36, 24)) and turned.exposure == pytest.approx(0.25)
    assert np.abs(np.asarray(Image.open(turned.image)).astype(int) - np.rot90(views(10), 3)).mean() < 4
    assert np.array_equal(np.asarray(Image.open(photographs[5].image)), views(11))
    assert cv2.imread(str(photographs[6].image), cv2.IMREAD_UNCHANGED).dtype == np.uint16
    assert len({p.lens for p in photographs}) == 4 and photographs[0].focal is None and all(p.mask is None for p in photographs)


def test_single_video(tmp_path, views, writers):
    writers.write_video(tmp_path / "v.mp4", [np.roll(views(0), 8 * i, 1) for i in range(12)], 1)
    photographs, left_out = read(tmp_path / "v.mp4", tmp_path / "out")
    assert len(photographs) == 5 and not left_out and {(p.width, p.height, p.turned) for p in photographs} == {(96, 128, 1)}
    assert {p.lens for p in photographs} == {"video v|128x96|portrait"} and all(p.exposure is None for p in photographs)


def test_second_reading_makes_nothing_again(tmp_path, write_views, views, writers, monkeypatch):
    photos, out = write_views(4), tmp_path / "out"
    writers.write_video(photos / "v.mp4", [np.roll(views(13), 8 * i, 1) for i in range(10)])
    (photos / "masks").mkdir()
    Image.new("L", (128, 96), 255).save(photos / "masks/IMG_2.png")
    first, before = read(photos, out), content(out)
    for module, name in ((reading, "copy_photograph"), (reading, "sharp_frames"), (reading, "write_given_mask"), (reading, "encoded")):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("made again"))
    assert read(photos, out) == first
    after = content(out)
    assert {n: v for n, v in after.items() if n != "photographs.json"} == {n: v for n, v in before.items() if n != "photographs.json"}
    assert after["photographs.json"][0] == before["photographs.json"][0]


def test_changed_or_missing_files_are_made_again(tmp_path, write_views, views):
    photos, out = write_views(5), tmp_path / "out"
    read(photos, out)
    kept = (out / "photographs/IMG_4.jpg").stat().st_mtime_ns
    Image.fromarray(views(20)).save(photos / "IMG_1.jpg", quality=80)
    (out / "photographs/IMG_2.jpg").unlink()
    photographs, _ = read(photos, out)
    assert photographs[0].image.read_bytes() == (photos / "IMG_1.jpg").read_bytes() and photographs[1].image.is_file()
    assert (out / "photographs/IMG_4.jpg").stat().st_mtime_ns == kept


@pytest.mark.parametrize(
    "damage", ["", "{", "[]", '{"version": 1}', '{"version": 1, "copies": {"IMG_1": {}}, "videos": {}, "masks": {}}', "wrong"]
)
def test_damaged_record_counts_as_none(tmp_path, write_views, damage):
    photos, out = write_views(3), tmp_path / "out"
    first = read(photos, out)
    record = out / "photographs.json"
    if damage == "wrong":
        entries = json.loads(record.read_text())
        entries["copies"]["IMG_1"]["suffix"] = "/../../IMG_1.jpg"
        damage = json.dumps(entries)
    record.write_text(damage)
    assert read(photos, out) == first
    assert set(json.loads(record.read_text())["copies"]) == {"IMG_1", "IMG_2", "IMG_3"}


def test_cancelled_reading_goes_on_where_it_stopped(tmp_path, write_views, heard, monkeypatch):
    photos, out = write_views(12), tmp_path / "out"
    with pytest.raises(Cancelled):
        read(photos, out, heard(4))
    done = set(json.loads((out / "photographs.json").read_text())["copies"])
    assert len(done) == 4
    made = []
    monkeypatch.setattr(
        reading, "copy_photograph", lambda source, name, folder: made.append(name) or copies.copy_photograph(source, name, folder)
    )
    progress = heard()
    assert len(read(photos, out, progress)[0]) == 12 and not done & set(made)
    assert progress.phases == [("read photographs", 12)] and progress.last == 12


def test_masks_are_turned_with_their_photographs(tmp_path, write_views, exif, heard):
    photos, out = write_views(5, exif=exif({ORIENTATION: 8})), tmp_path / "out"
    stored = np.zeros((96, 128), np.uint8)
    stored[:30, :30] = 255
    (photos / "masks").mkdir()
    Image.fromarray(stored).save(photos / "masks/IMG_1.jpg.png")
    Image.fromarray(np.rot90(stored)).save(photos / "IMG_2_mask.png")
    Image.new("L", (50, 50)).save(photos / "masks/IMG_3.png")
    (photos / "masks/IMG_4.png").write_bytes(b"no picture")
    progress = heard()
    photographs, _ = read(photos, out, progress)
    for p in photographs[:2]:
        assert p.mask == out / "given_masks" / f"{p.name}.png" and np.array_equal(np.asarray(Image.open(p.mask)), np.rot90(stored))
    assert [p.mask for p in photographs[2:]] == [None] * 3
    assert any("IMG_3: the mask has 50x50" in m for m in progress.messages) and any(
        "IMG_4: the mask unreadable" in m for m in progress.messages
    )


def test_alpha_is_a_mask_unless_one_is_given(tmp_path, views):
    photos, out = tmp_path / "photos", tmp_path / "out"
    (photos / "masks").mkdir(parents=True)
    alpha = np.zeros((96, 128), np.uint8)
    alpha[20:60, 30:90] = 255
    for i in range(3):
        Image.fromarray(np.dstack([views(i), alpha])).save(photos / f"{i}.png")
    given = photos / "masks/1.png"
    Image.fromarray(255 - alpha).save(given)
    photographs, _ = read(photos, out)
    assert [np.array_equal(np.asarray(Image.open(p.mask)), alpha) for p in photographs] == [True, False, True]
    assert np.asarray(Image.open(photographs[0].image)).shape == (96, 128, 3)
    given.unlink()
    photographs, _ = read(photos, out)
    assert np.array_equal(np.asarray(Image.open(photographs[1].mask)), alpha)


def test_removed_mask_is_not_used_any_more(tmp_path, write_views):
    photos, out = write_views(3), tmp_path / "out"
    Image.new("L", (128, 96), 255).save(photos / "IMG_1_mask.png")
    assert read(photos, out)[0][0].mask is not None
    (photos / "IMG_1_mask.png").unlink()
    assert read(photos, out)[0][0].mask is None and not list((out / "given_masks").iterdir())


def test_unreadable_files_are_left_out_by_name(tmp_path, write_views):
    photos = write_views(4)
    data = (photos / "IMG_2.jpg").read_bytes()
    (photos / "IMG_2.jpg").write_bytes(data[: len(data) // 2])
    (photos / "v.mp4").write_bytes(b"no video")
    photographs, left_out = read(photos, tmp_path / "out")
    assert [p.name for p in photographs] == ["IMG_1", "IMG_3", "IMG_4"]
    assert [one.name for one in left_out] == ["IMG_2", "v.mp4"] and isinstance(left_out[0], LeftOut)
    assert "truncated" in left_out[0].reason and "not a readable video" in left_out[1].reason


def test_fewer_than_three_are_refused(tmp_path, write_views):
    photos = write_views(3)
    shutil.copy(photos / "IMG_1.jpg", photos / "copy.jpg")
    (photos / "IMG_3.jpg").write_bytes(b"")
    with refused("has 2 usable photographs, fewer than 3", "left out: IMG_3", "folder with photographs"):
        read(photos, tmp_path / "out")


def test_results_inside_the_folder_of_photographs(tmp_path, write_views):
    photos = write_views(3)
    first = read(photos, photos / "run")
    assert read(photos, photos / "run") == first and len(read(photos, tmp_path / "other")[0]) == 3


def test_names_that_collide(tmp_path, views):
    photos = tmp_path / "photos"
    for i, name in enumerate(("a/1.jpg", "b/1.jpg", "2.jpg", "2.png", "con.jpg")):
        (photos / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(views(i)).save(photos / name)
    photographs, _ = read(photos, tmp_path / "out")
    assert [p.name for p in photographs] == ["2", "2_2", "a_1", "b_1", "_con"] and len({p.image for p in photographs}) == 5


def test_notes_are_told_once_for_all_photographs(tmp_path, write_views, heard):
    progress = heard()
    read(write_views(4, icc_profile=b"damaged"), tmp_path / "out", progress)
    assert len(progress.messages) == 1 and progress.messages[0].startswith("IMG_1 and 3 more: its colour profile can't be used")


def test_few_photographs_are_in_work_at_a_time(tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    drawn = []
    items = (drawn.append(i) or i for i in range(100))
    with ThreadPoolExecutor(2) as pool:
        results = reading.in_order(pool, lambda i: i * i, items, 4)
        assert [next(results) for _ in range(10)] == [i * i for i in range(10)] and len(drawn) <= 14
        results.close()


@pytest.mark.skipif(os.name == "nt", reason="rights of POSIX")
def test_photographs_may_be_read_only(tmp_path, write_views):
    photos = write_views(3)
    for file in (*photos.iterdir(), photos):
        file.chmod(0o500 if file.is_dir() else 0o400)
    try:
        assert len(read(photos, tmp_path / "out")[0]) == 3
    finally:
        photos.chmod(0o700)
