# SPDX-License-Identifier: GPL-3.0-or-later
"""SIFT features (Lowe 2004) of the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from PIL import Image

from ..errors import Cancelled
from ..io.image import read_image
from ..machine.thread_pool import thread_count
from ..progress.protocol import Progress
from .photograph import Photograph
from .quarter_turns import stored_size, turn_pixels
from .turntable import Turntable

Found = tuple[np.ndarray, pycolmap.FeatureDescriptors]


def extraction_options(thorough: bool) -> pycolmap.FeatureExtractionOptions:
    """Return COLMAP's options.

    Args:
        thorough: search fainter features too.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = 1, False
    if thorough:
        options.sift.peak_threshold /= 2
    return options


def find_features(
    photographs: Sequence[Photograph], path: Path, longest: int, thorough: bool, progress: Progress, turntable: Turntable | None = None
) -> None:
    """Write the features of all photographs that have none yet into the database, each in one transaction.

    Args:
        photographs: image i + 1 of the database is photograph i.
        path: the database file.
        longest: longest side in pixels of the image in which features are searched.
        thorough: see `extraction_options`.
        progress: receiver; it may cancel.
        turntable: static background of the photographs, whose features are left out; None where the camera moved.

    Raises:
        Cancelled: if the user stopped the job; features found so far are kept.
    """
    progress.phase("find features", len(photographs))
    options = extraction_options(thorough)
    with pycolmap.Database.open(path) as database, ThreadPoolExecutor(threads := thread_count()) as pool:
        waiting = [i for i in range(len(photographs)) if not database.exists_descriptors(i + 1)]
        running: dict[Future[Found], int] = {}
        done = len(photographs) - len(waiting)
        while waiting or running:
            while waiting and len(running) < threads and not progress.cancelled:
                i = waiting.pop(0)
                running[pool.submit(_extract, photographs[i], longest, options)] = i
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                i, found = running.pop(future), future.result()
                _write(database, i + 1, found if turntable is None else _moving(found, photographs[i], i, turntable))
                done += 1
                progress.step(done)
            if progress.cancelled:
                raise Cancelled(f"stopped after features were found in {done} photographs")


def _write(database: pycolmap.Database, number: int, found: Found) -> None:
    with pycolmap.DatabaseTransaction(database):
        database.write_keypoints(number, found[0])
        database.write_descriptors(number, found[1])


def _moving(found: Found, photograph: Photograph, number: int, turntable: Turntable) -> Found:
    """Return the features of a photograph that lie on what moves before a fixed camera."""
    table, descriptors = found
    upright = turn_pixels(table[:, :2], *stored_size(photograph), photograph.turned)
    kept = turntable.moving_features(number, upright / (photograph.width, photograph.height))
    return table[kept], pycolmap.FeatureDescriptors(descriptors.type, descriptors.data[kept])


def _extract(photograph: Photograph, longest: int, options: pycolmap.FeatureExtractionOptions) -> Found:
    """Find the features of one photograph; return keypoints (N, 4): x, y, scale in stored pixels, orientation; and descriptors."""
    grey = read_grey(photograph, longest)
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract(pycolmap.Bitmap.from_array(grey))
    table = pycolmap.keypoints_to_matrix(keypoints)
    table[:, :3] *= max(stored_size(photograph)) / max(grey.shape)
    return table, descriptors


def read_grey(photograph: Photograph, longest: int) -> np.ndarray:
    """Read a photograph as its sensor stored it.

    Args:
        photograph: the photograph.
        longest: longest side in pixels; larger ones are reduced by area averaging.

    Returns:
        Luma (H, W) uint8.
    """
    colour = read_image(photograph.image).colour
    if colour.dtype != np.uint8:
        colour = np.clip(colour * (255 / 65535 if colour.dtype == np.uint16 else 255), 0, 255).astype(np.uint8)
    grey = np.asarray(Image.fromarray(colour).convert("L")) if colour.ndim == 3 else colour
    scale = longest / max(grey.shape)
    if scale < 1:
        size = round(grey.shape[1] * scale), round(grey.shape[0] * scale)
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(np.rot90(grey, -photograph.turned))
