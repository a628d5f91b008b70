# SPDX-License-Identifier: GPL-3.0-or-later
"""Description of a finished capture for capture.json and its page: what was found in the photographs, and what was left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..datasets.exposure import SMALLEST
from ..scene.dataset import Bound
from .exposures import stated_log_gains
from .object_masks import ObjectMasks
from .photograph import LeftOut
from .sparse_model import SparseModel
from .undistortion import UndistortedImage


@dataclass(frozen=True, eq=False)
class CaptureResult:
    """Everything that a capture found.

    Attributes:
        model: sparse model, in its own frame.
        images: V undistorted images of `model.posed`.
        found: masks, and the object's place in the model's frame; None where nothing was cut out.
        gains: (V, 3) linear exposure gains.
        similarity: (4, 4) from the model's frame to the world.
        true_size: True where a unit of the world is a metre.
        left_out: photographs that were not used.
    """

    model: SparseModel
    images: list[UndistortedImage]
    found: ObjectMasks | None
    gains: np.ndarray
    similarity: np.ndarray
    true_size: bool
    left_out: list[LeftOut]

    @property
    def masks(self) -> Sequence[np.ndarray | None]:
        """Mask (H, W) of each image, or None."""
        return [None] * len(self.images) if self.found is None else self.found.masks

    @property
    def doubtful(self) -> dict[str, str]:
        """Names of images whose masks should be looked at, with the reason."""
        return {} if self.found is None else dict(self.found.doubtful)

    @property
    def bound(self) -> Bound | None:
        """Sphere about the object in the world; None where nothing was cut out."""
        return None if self.found is None else self.found.bound.moved(self.similarity)


def describe(result: CaptureResult) -> dict[str, Any]:
    """Return the entries of capture.json that say what was found, as plain values."""
    bound = result.bound
    return {
        "error": result.model.error,
        "bound": None if bound is None else {"centre": list(bound.centre), "radius": bound.radius},
        "plane": result.found is not None and result.found.plane is not None,
        "metres_per_unit": 1.0 if result.true_size else None,
        "masked": any(mask is not None for mask in result.masks),
        "photographs": _records(result),
        "left_out": [dataclasses.asdict(one) for one in result.left_out],
        "notes": _notes(result),
    }


def _records(result: CaptureResult) -> list[dict[str, Any]]:
    """Return a record of each photograph: name, source, exposure in EV, what is known of the mask."""
    records = []
    for one, mask, gain in zip(result.images, result.masks, result.gains, strict=True):
        name = one.view.name
        kind = result.doubtful.get(name, "none" if mask is None else "given" if one.mask is not None else "found")
        source = str(one.posed.photograph.source)
        records.append({"name": name, "source": source, "ev": float(np.log2(gain.mean())), "mask": kind})
    return records


def _notes(result: CaptureResult) -> list[str]:
    """Return lines about masks and exposure for the page."""
    notes = ["no masks: the whole scene is reconstructed"] if result.found is None else list(result.found.messages)
    if np.log(result.gains).std(0).max() >= SMALLEST:
        origin = "the points' colours" if stated_log_gains(result.model) is None else "EXIF, checked by the points' colours"
        notes.append(f"exposure differs by up to {np.ptp(np.log2(result.gains.mean(1))):.2f} EV, by {origin}")
    return notes
