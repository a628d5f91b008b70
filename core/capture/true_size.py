# SPDX-License-Identifier: GPL-3.0-or-later
"""True size of a captured dataset by the distance of two of its points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..datasets.formats.captured import FILE, load_capture
from ..errors import InputError
from ..settings.schema import CaptureSettings

WHERE = "--distance"


def with_true_size(settings: CaptureSettings, folder: Path, ends: Sequence[Sequence[float]], metres: float) -> CaptureSettings:
    """Return the settings with which the dataset of a finished capture gets its true size; a person's sphere keeps its place.

    Args:
        settings: of the finished capture.
        folder: folder of the capture.
        ends: (2, 3) points of the dataset, in its present coordinates.
        metres: their true distance.

    Raises:
        InputError: if the capture is not finished, or the points are not two places.
    """
    if not (folder / FILE).is_file() or load_capture(folder / FILE).get("status") != "done":
        # The coordinates of a stopped one may be those before or after the change.
        raise InputError(WHERE, f"needs a finished capture, which {folder} is not", "finish it by irgspp capture without this option")
    length = float(np.linalg.norm(np.subtract(*np.array(ends, np.float64))))
    if not (np.isfinite(length) and length > 0):
        raise InputError(WHERE, "names no two different points", "give X Y Z of both ends, and their distance such as 12cm")
    factor = metres / length
    if settings.centre is not None and settings.radius is not None:
        x, y, z = settings.centre
        settings = replace(settings, centre=(factor * x, factor * y, factor * z), radius=factor * settings.radius)
    return replace(settings, scale=factor * (settings.scale or 1.0))
