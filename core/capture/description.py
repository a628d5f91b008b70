# SPDX-License-Identifier: GPL-3.0-or-later
"""Description of a finished capture for capture.json and its page: what was found in the photographs, and what was left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..datasets.exposure import SMALLEST
from ..scene.dataset import Bound
from .chosen_sphere import other_things
from .exposures import stated_log_gains
from .object_masks import ObjectMasks
from .photograph import LeftOut
from .sparse_model import SparseModel
from .undistortion import UndistortedImage

MIN_MASKED = 0.5  # fraction of the photographs with a mask from which the others are left out


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
        light_rotations: rotation from the world to the frame of the light by the view's name, of a turntable; else None.
        sphere: the person's sphere about the object, in the world; None where the object was found by itself.
    """

    model: SparseModel
    images: list[UndistortedImage]
    found: ObjectMasks | None
    gains: np.ndarray
    similarity: np.ndarray
    true_size: bool
    left_out: list[LeftOut]
    light_rotations: dict[str, list[list[float]]] | None = None
    sphere: Bound | None = None

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
        """Sphere about the object in the world: the person's, else that of the masks; None where nothing was cut out."""
        return self.sphere or (None if self.found is None else self.found.bound.moved(self.similarity))

    @property
    def others(self) -> list[Bound]:
        """Spheres about other things near the object, in the world."""
        return [] if self.found is None else [one.moved(self.similarity) for one in self.found.others]


def describe(result: CaptureResult) -> dict[str, Any]:
    """Return the entries of capture.json that say what was found, as plain values."""
    bound = result.bound
    return {
        "error": result.model.error,
        "bound": None if bound is None else {"centre": list(bound.centre), "radius": bound.radius},
        "plane": result.found is not None and result.found.plane is not None,
        "metres_per_unit": 1.0 if result.true_size else None,
        "masked": any(mask is not None for mask in result.masks),
        "light_rotations": result.light_rotations,
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
    no_masks = ["no masks: the whole scene is reconstructed"]
    notes = no_masks if result.found is None else [*result.found.messages, *other_things(result.others)]
    if result.sphere is not None:
        notes.append("the object is what a given sphere holds (capture.centre, capture.radius)")
    if result.light_rotations is not None:
        notes.append("turntable: the camera was fixed and the object turned, so that the light turns about it")
    if np.log(result.gains).std(0).max() >= SMALLEST:
        origin = "the points' colours" if stated_log_gains(result.model) is None else "EXIF, checked by the points' colours"
        origin = origin if result.light_rotations is None else "the static background"
        notes.append(f"exposure differs by up to {np.ptp(np.log2(result.gains.mean(1))):.2f} EV, by {origin}")
    return notes


def with_object_shown(result: CaptureResult) -> CaptureResult:
    """Return a result without the photographs that have no mask, where others have one.

    The object is out of some photographs, and behind other things in others. A dataset of which some photographs lack masks would be
    reconstructed without any. Where most lack one and no sphere chose the object, all stay.
    """
    kept = [i for i, mask in enumerate(result.masks) if mask is not None]
    if result.found is None or (result.sphere is None and len(kept) < MIN_MASKED * len(result.masks)):
        return result
    reasons, gone = result.doubtful, {one.view.name for one in result.images} - {result.images[i].view.name for i in kept}
    return replace(
        result,
        model=result.model.subset(kept),
        images=[result.images[i] for i in kept],
        found=replace(
            result.found,
            masks=[result.found.masks[i] for i in kept],
            doubtful=[(name, reason) for name, reason in result.found.doubtful if name not in gone],
        ),
        gains=result.gains[kept],
        left_out=[*result.left_out, *(LeftOut(name, reasons.get(name, "does not show the object")) for name in sorted(gone))],
    )
