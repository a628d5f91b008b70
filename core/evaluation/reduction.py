# SPDX-License-Identifier: GPL-3.0-or-later
"""What is true of full-size images at the size that these are used at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..io.image import read_image, reduce_image, unit

Shape = tuple[int, int]


def fitted_layer(where: Path, name: str, layer: np.ndarray, shape: Shape, cover: np.ndarray | None = None) -> np.ndarray:
    """A layer (H', W'[, C]) at `shape` (H, W) by area averaging over what is there: `cover` (H', W') in 0..1, or what is not 0.

    Normals are made unit again. Raises InputError where its image can't be a reduction of that size.
    """
    full = layer.shape[0], layer.shape[1]
    check_reduction(where, f"its true {name}", full, shape)
    if full == shape and name != "normal":
        return layer
    vectors = layer if layer.ndim == 3 else layer[..., None]
    there = (np.linalg.norm(vectors, axis=-1) > (0.5 if name == "normal" else 0)).astype(np.float32)
    weight = cover if cover is not None and name not in ("normal", "depth") else there
    share = _area(weight, shape)[..., None]
    mean = _area(vectors * weight[..., None], shape).reshape(*shape, -1) / np.maximum(share, 1e-6)
    if name == "normal":
        mean /= np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-6)
    known = share > (0.5 if name in ("normal", "depth") else 0)
    return np.where(known, mean, 0).astype(np.float32).reshape(shape + layer.shape[2:])


def fitted_image(path: Path, shape: Shape, alpha: np.ndarray) -> np.ndarray:
    """(H, W, 3) encoded image of a file at `shape`, times its alpha, or times `alpha` where it has none."""
    stored = read_image(path)
    check_reduction(path, "it", (stored.size[1], stored.size[0]), shape)
    image = reduce_image(stored, shape[1], shape[0])
    own = alpha if image.alpha is None else unit(image.alpha)
    return np.maximum(unit(image.colour), 0) * own[..., None]


def check_reduction(where: Path, what: str, full: Shape, shape: Shape) -> None:
    """Raises InputError where `full` is neither `shape` nor that enlarged by one number."""
    (h, w), (height, width) = full, shape
    if (h, w) != shape and not (h > height and w > width and abs(w * height - h * width) <= max(h, w)):
        raise InputError(where, f"{what} is {w}x{h}, the view {width}x{height}", "evaluate at the images' own size (data.resolution)")


def _area(layer: np.ndarray, shape: Shape) -> np.ndarray:
    return cv2.resize(np.ascontiguousarray(layer, np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
