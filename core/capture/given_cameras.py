# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse model of photographs whose cameras a dataset gives, so that only the object has to be cut out of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..datasets.format_detection import NoDataset, parse_dataset
from ..datasets.load import OPAQUE, full_size_frames
from ..datasets.parsed_dataset import MINIMUM_VIEWS
from ..datasets.prepared_frames import PreparedFrame
from ..errors import InputError
from ..io.image import read_image, to_unit_range
from ..progress.protocol import Progress
from ..settings.schema import DataSettings
from .photograph import Photograph
from .photograph_files import VIDEOS
from .sparse_model import PosedPhotograph, SparseModel


def has_cameras(path: Path, progress: Progress) -> bool:
    """Return True for a dataset whose photographs have cameras.

    Args:
        path: what the user named as photographs.
        progress: is told where cameras can't be read, which are then searched.
    """
    if path.suffix.lower() in VIDEOS or not path.exists():
        return False
    try:
        parse_dataset(path, DataSettings())
    except NoDataset:
        return False
    except InputError as error:
        progress.message(f"warning: {error}; the cameras are searched instead")
        return False
    return True


def given_model(dataset: Path) -> SparseModel:
    """Return the photographs of a dataset but for declared test views, with its cameras and sparse points, which no track connects.

    Args:
        dataset: folder or file of a dataset in any known format.

    Raises:
        InputError: if the dataset is damaged, too few photographs are on the disk, one can't be cut, or all have masks.
    """
    frames = full_size_frames(dataset, DataSettings(), split="declared")
    if len(frames) < MINIMUM_VIEWS:
        raise InputError(dataset, f"has {len(frames)} photographs on the disk, at least {MINIMUM_VIEWS} are needed")
    if all(frame.frame.mask is not None or _is_cut(frame) for frame in frames):
        raise InputError(dataset, "has masks already", "reconstruct it as it is")
    posed = [PosedPhotograph(_photograph(frame), frame.lens, frame.frame.to_world) for frame in frames]
    points, none = parse_dataset(dataset, DataSettings()).points, np.empty(0, np.int32)
    position = np.empty((0, 3)) if points is None else points.position.astype(np.float64)
    colour = np.empty((0, 3), np.uint8) if points is None else np.round(255 * points.colour).astype(np.uint8)
    return SparseModel(posed, position, colour, none, none, np.empty((0, 2), np.float32), None, [])


def _is_cut(frame: PreparedFrame) -> bool:
    """Return True for an image with an alpha channel that is not opaque."""
    alpha = None if frame.frame.image is None else read_image(frame.frame.image).alpha
    return alpha is not None and bool((to_unit_range(alpha) < OPAQUE).any())


def _photograph(prepared: PreparedFrame) -> Photograph:
    """Return a frame as a photograph that needs no copy."""
    frame, lens = prepared.frame, prepared.lens
    assert frame.image is not None
    if frame.image.suffix.lower() == ".exr":
        raise InputError(frame.image, "is a linear image", "only photographs in JPEG and PNG files can be cut")
    mask = None if frame.far is not None else frame.mask
    return Photograph(prepared.name, frame.image, frame.image, lens.width, lens.height, str(lens), mask=mask)
