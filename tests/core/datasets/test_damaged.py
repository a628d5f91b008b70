# SPDX-License-Identifier: GPL-3.0-or-later
"""Valid files with bytes changed, lost or added give an InputError or a valid result, and nothing else."""

import contextlib
import struct

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from irgspp.core.datasets.formats.colmap_model import read_cameras, read_images, read_points
from irgspp.core.datasets.load import load_dataset_cameras
from irgspp.core.errors import InputError
from irgspp.core.io.image import read_image
from PIL import Image

fuzz = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def damage(data: bytes, cut: float, edits) -> bytes:
    spoiled = bytearray(data[: int(cut * len(data))])
    for place, value in edits:
        if spoiled:
            spoiled[int(place * (len(spoiled) - 1))] = value
    return bytes(spoiled)


places = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=6)
cuts = st.one_of(st.just(1.0), st.floats(0, 1))


@fuzz
@given(cuts, places, st.sampled_from(["cameras.bin", "images.bin", "points3D.bin", "cameras.txt", "images.txt", "points3D.txt"]))
def test_damaged_models(tmp_path_factory, cut, edits, file):
    folder = tmp_path_factory.mktemp("model")
    path = folder / file
    path.write_bytes(damage(SAMPLES[file], cut, edits))
    reader = {"c": read_cameras, "i": read_images, "p": read_points}[file[0]]
    with contextlib.suppress(InputError):
        reader(path)


@fuzz
@given(cuts, places, st.sampled_from(["picture.png", "picture.jpg", "deep.png", "picture.exr"]))
def test_damaged_images(tmp_path_factory, cut, edits, file):
    path = tmp_path_factory.mktemp("picture") / file
    path.write_bytes(damage(SAMPLES[file], cut, edits))
    with contextlib.suppress(InputError):
        image = read_image(path)
        assert image.colour.shape[2] == 3 and np.isfinite(image.colour).all()


@fuzz
@given(cuts, places, st.binary(max_size=30))
def test_damaged_transforms(ball_dataset, cut, edits, noise):
    path = ball_dataset.folder / "transforms.json"
    if not path.exists():
        ball_dataset.transforms()
        SAMPLES["transforms.json"] = path.read_bytes()
    path.write_bytes(damage(SAMPLES["transforms.json"], cut, edits) + (noise if cut < 0.5 else b""))
    with contextlib.suppress(InputError):
        load_dataset_cameras(ball_dataset.folder, "all")


SAMPLES: dict[str, bytes] = {}


@pytest.fixture(scope="module", autouse=True)
def samples(tmp_path_factory):
    """Valid files to damage."""
    folder = tmp_path_factory.mktemp("samples")
    rng = np.random.default_rng(0)
    camera = struct.pack("<QIiQQ4d", 1, 1, 1, 60, 48, 70, 70, 30, 24)
    pose = struct.pack("<I7dI", 1, 1, 0, 0, 0, 0, 0, 4, 1) + b"a.png\0" + struct.pack("<QddQ", 1, 1.5, 2.5, 3)
    point = struct.pack("<Q3d3BdQII", 1, 0.1, 0.2, 0.3, 1, 2, 3, 0.5, 1, 1, 0)
    SAMPLES.update(
        {
            "cameras.bin": camera,
            "images.bin": struct.pack("<Q", 3) + 3 * pose,
            "points3D.bin": struct.pack("<Q", 3) + 3 * point,
            "cameras.txt": b"# c\n1 PINHOLE 60 48 70 70 30 24\n",
            "images.txt": 3 * b"1 1 0 0 0 0 0 4 1 a.png\n1.5 2.5 3\n",
            "points3D.txt": 3 * b"1 0.1 0.2 0.3 1 2 3 0.5 1 0\n",
        }
    )
    pixels = rng.integers(0, 256, (24, 30, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(folder / "picture.png")
    Image.fromarray(pixels).save(folder / "picture.jpg")
    cv2.imwrite(str(folder / "deep.png"), pixels.astype(np.uint16) * 257)
    channels = {n: np.ascontiguousarray(pixels[..., i], np.float32) for i, n in enumerate("RGB")}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(folder / "picture.exr"))
    SAMPLES.update({p.name: p.read_bytes() for p in folder.iterdir()})
