# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks to paint on: opened over their photograph, saved as the engine reads them, never saved unless painted."""

import json
import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from blender_side import ROOT, in_engine, read_image
from irgspp.core.errors import InputError
from irgspp.irgspp_addon.importer import mask_image
from irgspp.irgspp_addon.importer.mask_image import DIM, is_captured_camera, open_mask, save_masks
from irgspp.irgspp_addon.importer.ownership import KEY


@pytest.fixture
def folder(captured, tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True)
    return shutil.copytree(captured, tmp_path / "copy").resolve()


def read_mask(file: Path) -> np.ndarray:
    """A mask (H, W) as the engine reads it."""
    return np.array(json.loads(in_engine(ROOT / "tests" / "support" / "mask_values.py", file)), np.float32)


def camera(folder, name: str) -> bpy.types.Object:
    placed = bpy.data.objects.new(f"train {name}", bpy.data.cameras.new(name))
    placed[KEY] = f"{folder}#camera train {name}"
    return placed


def alpha(image: bpy.types.Image) -> np.ndarray:
    """Alpha (H, W), top row first."""
    values = np.array(image.pixels[:]).reshape(image.size[1], image.size[0], 4)
    return values[::-1, :, 3]


def paint(image: bpy.types.Image, rows: slice, columns: slice, value: float) -> None:
    """Paint a rectangle, with rows from the top."""
    values = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)
    values[::-1][rows, columns, 3] = value
    image.pixels.foreach_set(values.reshape(-1))
    image.update()


def test_the_photograph_is_opaque_inside_and_dim_outside(folder):
    image = open_mask(camera(folder, "000"))
    photograph = read_image(folder / "images" / "000.png")
    assert np.allclose(np.array(image.pixels[:]).reshape(*photograph.shape[:2], 4)[::-1, :, :3], photograph, atol=1 / 255)
    expected = np.where(read_mask(folder / "masks" / "000.png") > 0.9, 1.0, DIM)
    outside_edge = np.r_[0:40, 44:62]
    assert np.allclose(alpha(image)[outside_edge], expected[outside_edge], atol=1e-3)
    assert image.name == "000 mask" and not save_masks()  # nothing was painted


def test_what_is_painted_is_what_the_engine_reads(folder):
    image, before = open_mask(camera(folder, "000")), read_mask(folder / "masks" / "000.png")
    paint(image, slice(10, 20), slice(20, 30), 0.0)  # erased
    paint(image, slice(50, 55), slice(0, 5), 1.0)  # added
    assert save_masks() == [folder / "masks" / "000.png"] and save_masks() == []
    expected = before.copy()
    expected[10:20, 20:30], expected[50:55, 0:5] = 0, 1
    assert np.allclose(read_mask(folder / "masks" / "000.png"), expected, atol=1.5 / 255)
    assert ((read_mask(folder / "masks" / "000.png") == 0) == (expected == 0)).all()
    assert not list((folder / "masks").glob(".*"))


def test_a_photograph_without_a_mask_begins_as_object_everywhere(folder):
    image = open_mask(camera(folder, "005"))
    assert (alpha(image) == 1).all() and not save_masks() and not (folder / "masks" / "005.png").exists()
    paint(image, slice(0, 62), slice(0, 45), 0.0)
    shutil.rmtree(folder / "masks")  # also where nothing has a mask yet
    assert save_masks() == [folder / "masks" / "005.png"]
    assert read_mask(folder / "masks" / "005.png").mean() == pytest.approx(0.5)
    paint(image, slice(0, 62), slice(0, 90), 1.0)
    assert save_masks() and (read_mask(folder / "masks" / "005.png") == 1).all()


def test_opening_again_keeps_what_was_painted_and_reads_a_new_file(folder):
    placed = camera(folder, "000")
    image = open_mask(placed)
    paint(image, slice(0, 5), slice(0, 5), 1.0)
    assert open_mask(placed) == image and alpha(image)[2, 2] == 1
    save_masks()
    shutil.copy(folder / "masks" / "001.png", folder / "masks" / "000.png")
    assert open_mask(placed) == image and alpha(image)[2, 2] == pytest.approx(DIM)


def test_an_image_lost_by_loading_the_file_is_not_saved(folder, tmp_path):
    image = open_mask(camera(folder, "000"))
    paint(image, slice(0, 9), slice(0, 9), 1.0)
    image.use_fake_user = True
    before = (folder / "masks" / "000.png").read_bytes()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert any(mask_image.MASK in image for image in bpy.data.images)
    assert save_masks() == [] and (folder / "masks" / "000.png").read_bytes() == before


def test_other_cameras_and_missing_photographs_are_refused(folder, tmp_path):
    stranger = bpy.data.objects.new("stranger", bpy.data.cameras.new("stranger"))
    assert not is_captured_camera(stranger) and not is_captured_camera(None) and is_captured_camera(camera(folder, "000"))
    with pytest.raises(InputError, match="is not a camera of a captured dataset"):
        open_mask(stranger)
    with pytest.raises(InputError, match="has no photograph 099"):
        open_mask(camera(folder, "099"))
    shutil.copy(folder / "contact_sheet.png", folder / "masks" / "003.png")
    with pytest.raises(InputError, match="is not of its photograph's size"):
        open_mask(camera(folder, "003"))
