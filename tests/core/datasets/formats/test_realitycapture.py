# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of RealityCapture: both separators, and hostile or damaged files."""

import numpy as np
import pytest
from irgspp.core.datasets.format_detection import parse_dataset
from irgspp.core.datasets.load import load_dataset
from irgspp.core.settings.schema import DataSettings
from refused import refused

HEAD = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("../secret.png,0,0,0,0,0,0,40,0,0,0,0,0,0,0,0", ["leads out"]),
        ("003.png,0,0,0,0,0,0,40,0,0,0,0,0,0.1,0,0", ["k4"]),
        ("003.png,0,0,0,0,0,0,wide,0,0,0,0,0,0,0,0", ["f is not a number"]),
        ("003.png,0,nan,0,0,0,0,40,0,0,0,0,0,0,0,0", ["y is not a number"]),
        ("x" * 200_000 + ",0,0,0,0,0,0,40", ["not a readable table"]),
        ("003.png,1e30,0,0,0,0,0,40,0,0,0,0,0,0,0,0", ["infinity"]),
        ("003.png,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0", ["focal"]),
    ],
)
def test_hostile_and_damaged_cameras_of_realitycapture(confined_dataset, row, words):
    confined_dataset.save_images([f"images/{i:03d}.png" for i in range(10)])
    rows = [f"{i:03d}.png,{i},0,0,{20 * i},40,0,40,0,0,0,0,0,0,0,0" for i in range(10)]
    file = confined_dataset.folder / "cameras.csv"
    file.write_text("\n".join(["#cameras 10", HEAD, *rows]))
    assert parse_dataset(confined_dataset.folder, DataSettings()).format == "realitycapture"
    file.write_text("\n".join([HEAD, *rows[:3], row, *rows[4:]]))
    with refused(*words):
        load_dataset(confined_dataset.folder)


def test_capture_of_realitycapture_with_a_semicolon(confined_dataset):
    confined_dataset.save_images([f"{i:03d}.png" for i in range(10)])
    rows = [f"{i:03d};{i};0;0;{20 * i};40;0;40;0.01;-0.02;0;0;0;0;0;0" for i in range(10)]  # names without extension, images beside
    (confined_dataset.folder / "cameras.csv").write_text("\n".join([HEAD.replace(",", ";"), *rows]))
    parsed = parse_dataset(confined_dataset.folder, DataSettings())
    lens = parsed.train[0].lens
    assert len(parsed.train) == 10 and np.allclose((lens.fx, lens.cx, lens.cy), (40 / 36 * 60, 30.6, 22.8))
