# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse model of a capture with known cameras, points and tracks, in photographs of a distorting lens."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.sparse_model import PosedPhotograph, SparseModel
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.scene.camera import Camera, look_at
from PIL import Image

LENS = Lens("OPENCV", 96, 72, 90.0, 91.0, 47.0, 37.0, (-0.08, 0.02, 0.001, -0.002, 0.0))
VIEWS, POINTS = 6, 80


def distorted_pixels(points: np.ndarray, to_world: np.ndarray, lens: Lens = LENS) -> np.ndarray:
    """Project points (P, 3) into the photograph of a lens, by OpenCV; returns pixels (P, 2), pixel centres at .5."""
    to_camera = Camera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, to_world).world_to_cv
    rotation, _ = cv2.Rodrigues(to_camera[:3, :3])
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    return cv2.projectPoints(points, rotation, to_camera[:3, 3], matrix, np.array(lens.distortion))[0].reshape(-1, 2)


def sparse_model(folder: Path, gains: np.ndarray | None = None) -> SparseModel:
    """Write photographs with a grey gradient and a bright dot at each point, and return their model with true cameras.

    Args:
        folder: for the photographs.
        gains: (VIEWS,) linear exposure gains; None for 1.
    """
    rng = np.random.default_rng(0)
    points = rng.normal(scale=0.3, size=(POINTS, 3))
    folder.mkdir(parents=True, exist_ok=True)
    posed, tracks = [], []
    for i in range(VIEWS):
        angle = 2 * np.pi * i / VIEWS - np.pi / 2
        to_world = look_at((3 * np.cos(angle), 3 * np.sin(angle), 0.8), (0, 0, 0))
        pixels = distorted_pixels(points, to_world)
        image = np.full((LENS.height, LENS.width, 3), 90.0) * (1 if gains is None else gains[i] ** (1 / 2.2))
        for x, y in np.floor(pixels).astype(int):
            image[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] = 180 * (1 if gains is None else gains[i] ** (1 / 2.2))
        path = folder / f"p{i}.png"
        Image.fromarray(image.astype(np.uint8)).save(path)
        photograph = Photograph(f"p{i}", path, path, LENS.width, LENS.height, "lens", exposure=None if gains is None else gains[i] / 100)
        posed.append(PosedPhotograph(photograph, LENS, to_world))
        inside = np.flatnonzero((pixels >= 0).all(1) & (pixels < LENS.size).all(1))
        tracks.append((inside, np.full(len(inside), i), pixels[inside]))
    place, photograph, pixel = (np.concatenate(part) for part in zip(*tracks, strict=True))
    colour = rng.integers(0, 256, (POINTS, 3)).astype(np.uint8)
    return SparseModel(posed, points, colour, place.astype(np.int32), photograph.astype(np.int32), pixel.astype(np.float32), 0.3, [])
