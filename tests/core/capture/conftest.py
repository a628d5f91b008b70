# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs for the tests of a capture, and a scene of a box on a table with its dense points and masks, computed once."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from irgspp.core.capture.dense_points import DensePoints, find_dense_points
from irgspp.core.capture.object_masks import ObjectMasks, cut_out
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.schema import CaptureSettings
from PIL import Image
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    table = script("stresses.table_scene")

EXIF_IFD = 0x8769
SIZE = (96, 128)  # rows and columns


class Heard(Silent):
    """Progress that keeps the messages, and stops after some steps."""

    def __init__(self, steps: int = 1 << 30):
        self.messages, self.phases, self.last, self.steps = [], [], 0, steps

    @property
    def cancelled(self):
        return self.last >= self.steps

    def message(self, text):
        self.messages.append(text)

    def phase(self, name, steps):
        self.phases.append((name, steps))

    def step(self, done, **metrics):
        self.last = done


def texture(seed: int, size: tuple[int, int] = SIZE, sigma: float = 1.0) -> np.ndarray:
    """Smooth random colours (H, W, 3) uint8 of full contrast."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(*size, 3)), (0, 0), sigma)
    return np.clip(128 + 60 * noise / noise.std(), 0, 255).astype(np.uint8)


def exif_bytes(main: dict | None = None, shot: dict | None = None) -> bytes:
    """EXIF with tags of the main and the EXIF directory."""
    exif = Image.Exif()
    exif.update(main or {})
    exif.get_ifd(EXIF_IFD).update(shot or {})
    return exif.tobytes()


@pytest.fixture(scope="session")
def heard() -> type[Heard]:
    return Heard


@pytest.fixture(scope="session")
def views() -> Callable[..., np.ndarray]:
    return texture


@pytest.fixture(scope="session")
def exif() -> Callable[..., bytes]:
    return exif_bytes


@pytest.fixture
def write_views(tmp_path: Path) -> Callable[..., Path]:
    """Function that writes different views into a folder."""

    def write(count: int, suffix: str = ".jpg", name: str = "photos", **options: object) -> Path:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        for i in range(count):
            Image.fromarray(texture(i)).save(folder / f"IMG_{i + 1}{suffix}", **options)
        return folder

    return write


@pytest.fixture(scope="session")
def writers() -> ModuleType:
    """Writers of RAW files and videos."""
    with scripts_on_path() as script:
        return script("formats.photographs")


@pytest.fixture(scope="session")
def table_scene():
    """Photographs of a box and other things on a table."""
    return table.photographed_table()


@pytest.fixture(scope="session")
def dense(table_scene) -> DensePoints:
    return find_dense_points(table_scene.views, table_scene.points, None, 0, Silent())


@pytest.fixture(scope="session")
def table_masks(table_scene) -> ObjectMasks:
    found = cut_out(table_scene.views, table_scene.points, CaptureSettings(), 0, Silent())
    assert found is not None
    return found
