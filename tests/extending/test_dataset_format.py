# SPDX-License-Identifier: GPL-3.0-or-later
"""Example of docs/architecture.md, "to add a dataset format": cameras in a CSV, one line an image."""

import csv

import numpy as np
import pytest
from irgspp.core.datasets import format_detection
from irgspp.core.datasets.load import load_dataset
from irgspp.core.datasets.parsed_dataset import Frame, Lens, ParsedDataset
from irgspp.core.errors import InputError
from PIL import Image

# --- core/datasets/formats/turntable.py: recognise a folder, read it


def find_table(folder):
    """Return the table of cameras of a folder, or None."""
    file = folder / "turntable.csv"
    return file if file.is_file() else None


def read_turntable(folder, settings):
    """Read the cameras of a turntable: image, degrees about +Z, distance, focal length in pixels."""
    frames = []
    with find_table(folder).open(newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.DictReader(file), 2):
            try:
                angle, distance, focal = (float(row[name]) for name in ("degrees", "distance", "focal"))
            except (KeyError, TypeError, ValueError) as error:
                where = f"{folder / 'turntable.csv'}, line {number}"
                raise InputError(where, "needs image, degrees, distance and focal", "complete the line or remove it") from error
            lens = Lens("PINHOLE", 48, 48, focal, focal, 24.0, 24.0)
            frames.append(Frame(row["image"], folder / row["image"], None, lens, pose(angle, distance)))
    return ParsedDataset(folder, folder, "turntable", frames, None, np.eye(4))


def pose(degrees, distance):
    """Return the (4, 4) camera to world that looks at the origin from the horizon."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    to_world = np.eye(4)
    to_world[:3, :3] = np.array([[-s, 0, c], [c, 0, s], [0, 1, 0]])
    to_world[:3, 3] = distance * np.array([c, s, 0])
    return to_world


# --- the test: one line in the table of formats, and every command reads it


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(format_detection, "SPECIFIC_FORMATS", ((find_table, read_turntable), *format_detection.SPECIFIC_FORMATS))
    disk = np.hypot(*(np.mgrid[:48, :48] - 23.5)) < 12
    lines = ["image,degrees,distance,focal"]
    for i in range(12):
        rgba = np.dstack([np.full((48, 48, 3), 128, np.uint8), np.where(disk, 255, 0).astype(np.uint8)])
        Image.fromarray(rgba).save(tmp_path / f"{i:02d}.png")
        lines.append(f"{i:02d}.png,{30 * i},4,48")
    (tmp_path / "turntable.csv").write_text("\n".join(lines))
    return tmp_path


def test_a_new_format_is_recognised_and_read(folder):
    dataset = load_dataset(folder)
    assert dataset.format == "turntable" and len(dataset.train) + len(dataset.test) == 12 and dataset.has_alpha
    view = dataset.train[0]
    assert np.allclose(view.camera.project(np.zeros((1, 3)))[0], [24, 24], atol=1e-6)
    assert view.colour.shape == (48, 48, 3) and abs(view.alpha.sum() - np.pi * 12**2) < 20


def test_a_bad_line_is_one_clear_error(folder):
    (folder / "turntable.csv").write_text("image,degrees,distance,focal\n00.png,x,4,48\n")
    with pytest.raises(InputError, match=r"turntable\.csv, line 2: needs image, degrees, distance and focal; complete the line"):
        load_dataset(folder)
