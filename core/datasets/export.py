# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a dataset to files that need no library but numpy to read, from which Blender builds cameras and points."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import Cancelled, InputError
from ..io.atomic import write_atomic
from ..io.quantisation import eight_bits
from ..progress.protocol import Progress
from ..scene.camera_files import save_views
from ..scene.dataset import Dataset, View
from ..settings.schema import DataSettings
from .load import full_size_views
from .summary import summary


def save_dataset(dataset: Dataset, settings: DataSettings, folder: Path, progress: Progress) -> None:
    """Write cameras.json, points.npz (if there are points), and dataset.json, which is written last and marks the folder as complete.

    The cameras are those of the unreduced photographs; of photographs with lens distortion, undistorted copies are written to
    `photographs/`. points.npz holds `position` (P, 3) float32 in the world and `colour` (P, 3) uint8 sRGB; dataset.json is
    `summary.summary`.

    Args:
        dataset: the dataset, as read with these settings.
        settings: its settings.
        folder: the folder to write.
        progress: reports the photographs, and cancels.

    Raises:
        InputError: if the folder can't be written or a photograph has changed.
        Cancelled: if the user stopped the work.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "dataset.json").unlink(missing_ok=True)
        save_views(folder / "cameras.json", _with_progress(dataset, settings, progress))
        (folder / "points.npz").unlink(missing_ok=True)
        if dataset.points is not None:
            data = io.BytesIO()
            np.savez(data, position=dataset.points.position, colour=eight_bits(dataset.points.colour))
            write_atomic(folder / "points.npz", data.getvalue())
        write_atomic(folder / "dataset.json", json.dumps(summary(dataset), indent=1).encode())
    except OSError as error:
        raise InputError(folder, f"can't be written ({error.strerror})") from error


def _with_progress(dataset: Dataset, settings: DataSettings, progress: Progress) -> Iterator[tuple[str, View]]:
    """Yield (split, view) of the unreduced photographs, and report each to `progress`."""
    progress.phase("export", len(dataset.train) + len(dataset.test))
    for done, pair in enumerate(full_size_views(dataset, settings), 1):
        if progress.cancelled:
            raise Cancelled("stopped while photographs were being exported")
        yield pair
        progress.step(done)
