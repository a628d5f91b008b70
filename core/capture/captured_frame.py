# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame of a captured dataset, which is kept where the object is cut out again, so that cameras and spheres stay in their places."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..settings.schema import CaptureSettings
from .dataset_files import write_json
from .sparse_model import SparseModel

FILE = "frame.json"
ROUNDING = 1e-6  # relative difference of camera matrices that were written to a file and read back


@dataclass(frozen=True, eq=False)
class CapturedFrame:
    """Frame in which a capture is written: that of the object which is found without a person's sphere.

    Attributes:
        similarity: (4, 4) from the sparse model's frame to the world.
        true_size: a unit of the world is a metre.
    """

    similarity: np.ndarray
    true_size: bool

    def save(self, folder: Path, model: SparseModel, settings: CaptureSettings) -> None:
        """Write the frame into a capture's folder, with the cameras and settings that it depends on.

        Args:
            folder: folder of the capture.
            model: sparse model, in its own frame.
            settings: settings of the capture; the person's sphere does not count.
        """
        frame = {"similarity": self.similarity.tolist(), "true_size": self.true_size}
        write_json(folder / FILE, {**frame, "settings": _settings(settings), "cameras": _cameras(model)})


def load_frame(folder: Path, model: SparseModel, settings: CaptureSettings) -> CapturedFrame | None:
    """Return the frame of an earlier cut of the same model with the same settings but for the sphere; None without one.

    Args:
        folder: folder of the capture.
        model: sparse model, in its own frame.
        settings: settings of the capture.
    """
    try:
        state = json.loads((folder / FILE).read_text("utf-8"))
        similarity = np.array(state["similarity"], np.float64)
        same = state["settings"] == _settings(settings) and _same_cameras(state["cameras"], _cameras(model))
        usable = same and similarity.shape == (4, 4) and bool(np.isfinite(similarity).all())
        return CapturedFrame(similarity, bool(state["true_size"])) if usable else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # missing or damaged: it is found again
        return None


def _settings(settings: CaptureSettings) -> dict[str, Any]:
    """Return the settings without the person's sphere, as plain values."""
    return dataclasses.asdict(replace(settings, centre=None, radius=None))


def _cameras(model: SparseModel) -> dict[str, list[list[float]]]:
    return {one.photograph.name: one.to_world.tolist() for one in model.posed}


def _same_cameras(before: dict[str, Any], now: dict[str, Any]) -> bool:
    if list(before) != list(now):
        return False
    old, new = (np.array(list(cameras.values()), np.float64) for cameras in (before, now))
    return bool(np.allclose(old, new, rtol=ROUNDING, atol=ROUNDING * np.abs(new).max()))
