# SPDX-License-Identifier: GPL-3.0-or-later
"""Reduction of full-size ground-truth layers and images to the size that the views are used at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..io.image import read_image, reduce_image, to_unit_range

Shape = tuple[int, int]


def fitted_layer(where: Path, name: str, layer: np.ndarray, shape: Shape, cover: np.ndarray | None = None) -> np.ndarray:
    """Resize a layer by area averaging over the covered pixels; normals are made unit again.

    Args:
        where: folder of the view, for the error message.
        name: of the layer, "normal", "depth" or another.
        layer: (H', W') or (H', W', C).
        shape: (H, W) to resize to.
        cover: (H', W') in 0..1, weights of the pixels; None: pixels that are not 0 (normals: not shorter than 0.5).

    Returns:
        (H, W) or (H, W, C) float32, 0 where nothing is covered.

    Raises:
        InputError: when `shape` is not the layer's size reduced.
    """
    full = layer.shape[0], layer.shape[1]
    check_reduction(where, f"its true {name}", full, shape)
    if full == shape and name != "normal":
        return layer
    vectors = layer if layer.ndim == 3 else layer[..., None]
    covered = (np.linalg.norm(vectors, axis=-1) > (0.5 if name == "normal" else 0)).astype(np.float32)
    weight = cover if cover is not None and name not in ("normal", "depth") else covered
    fraction = _area(weight, shape)[..., None]
    mean = _area(vectors * weight[..., None], shape).reshape(*shape, -1) / np.maximum(fraction, 1e-6)
    if name == "normal":
        mean /= np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-6)
    known = fraction > (0.5 if name in ("normal", "depth") else 0)
    return np.where(known, mean, 0).astype(np.float32).reshape(shape + layer.shape[2:])


def fitted_image(path: Path, shape: Shape, alpha: np.ndarray) -> np.ndarray:
    """Read an image file and resize it.

    Args:
        path: of the file.
        shape: (H, W) to resize to.
        alpha: (H, W), used where the file has no alpha of its own.

    Returns:
        (H, W, 3) encoded, times alpha.

    Raises:
        InputError: when `shape` is not the file's size reduced.
    """
    stored = read_image(path)
    check_reduction(path, "it", (stored.size[1], stored.size[0]), shape)
    image = reduce_image(stored, shape[1], shape[0])
    own = alpha if image.alpha is None else to_unit_range(image.alpha)
    return np.maximum(to_unit_range(image.colour), 0) * own[..., None]


def check_reduction(where: Path, what: str, full: Shape, shape: Shape) -> None:
    """Check that an image of one size can be reduced to another one by a common factor.

    Args:
        where: file or folder, for the error message.
        what: subject of the message, such as "its true normal".
        full: (H', W') of the image.
        shape: (H, W) of the view.

    Raises:
        InputError: when `full` is neither `shape` nor that enlarged by one number.
    """
    (h, w), (height, width) = full, shape
    if (h, w) != shape and not (h > height and w > width and abs(w * height - h * width) <= max(h, w)):
        raise InputError(where, f"{what} is {w}x{h}, the view {width}x{height}", "evaluate at the images' own size (data.resolution)")


def _area(layer: np.ndarray, shape: Shape) -> np.ndarray:
    """Average a layer (H', W') or (H', W', C) over the pixels of `shape` (H, W)."""
    return cv2.resize(np.ascontiguousarray(layer, np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
