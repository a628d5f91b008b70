# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration of the confidence of materials and light: whether the error is large where the confidence is low."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..io.srgb import encode_srgb
from .ground_truth import Truth
from .prediction import Prediction

NAMES = ("albedo", "roughness", "metallic")  # in the order of the confidence's channels
LIGHT = "environment"  # as in the names of the light's metrics
LEAST_SURE, SUREST = 0.1, 0.5  # fractions of the pixels, or of the sphere, that the figure compares
PARTS = 10  # of the curve
EXACT = 1e-4  # mean error that counts as none


@dataclass
class Calibration:
    """Confidence and error of the object's pixels in all views, gathered view by view, and of directions of the light."""

    _pairs: dict[str, list[np.ndarray]] = field(default_factory=lambda: {name: [] for name in (*NAMES, LIGHT)})

    def gather(self, prediction: Prediction, truth: Truth, scale: np.ndarray | None) -> None:
        """Add the pixels of one view; nothing where the confidence or the truth is not known.

        Args:
            prediction: of the view.
            truth: of the view.
            scale: (3,) factors of the albedo for all views; None where there are none: then albedo does not count.
        """
        if prediction.buffers.confidence is None:
            return
        confidence, inside = prediction.layer("confidence"), truth.object
        for channel, name in enumerate(NAMES):
            true = getattr(truth, name)
            if true is None or (name == "albedo" and scale is None):
                continue
            error = _error(prediction.layer(name), true, scale if name == "albedo" else None)
            self._pairs[name].append(np.stack([confidence[..., channel][inside], error[inside]]))

    def gather_light(self, confidence: np.ndarray, error: np.ndarray) -> None:
        """Add directions of the light, evenly spread over the sphere.

        Args:
            confidence: lat-long map (H, W).
            error: lat-long map (H, W) of the mean difference of encoded values.
        """
        height, width = error.shape
        counts = np.ceil(width * np.sin((np.arange(height) + 0.5) * np.pi / height)).astype(int)
        rows = np.repeat(np.arange(height), counts)
        columns = np.concatenate([np.arange(count) * width // count for count in counts])
        self._pairs[LIGHT].append(np.stack([confidence[rows, columns], error[rows, columns]]))

    def figures(self) -> dict[str, float]:
        """Return, for each material and the light, the mean error of the least sure LEAST_SURE over that of the surest SUREST."""
        values = {}
        for name, (_, error) in self._sorted().items():
            least, surest = error[: max(1, int(LEAST_SURE * len(error)))], error[-max(1, int(SUREST * len(error))) :]
            values[f"{name}_confidence_ratio"] = float(least.mean()) / max(float(surest.mean()), EXACT)
        return values

    def curves(self) -> dict[str, list[dict[str, float]]]:
        """Return, for each material and the light, PARTS of equal size from the least sure on: mean "confidence" and mean "error"."""
        curves = {}
        for name, pairs in self._sorted().items():
            parts = [part.mean(1) for part in np.array_split(pairs, PARTS, axis=1) if part.size]
            curves[name] = [{"confidence": float(confidence), "error": float(error)} for confidence, error in parts]
        return curves

    def _sorted(self) -> dict[str, np.ndarray]:
        """Return confidence and error (2, P) of what is known, the least sure first."""
        joined = {name: np.concatenate(pairs, 1) for name, pairs in self._pairs.items() if pairs}
        return {name: pairs[:, np.argsort(pairs[0], kind="stable")] for name, pairs in joined.items() if pairs.size}


def _error(ours: np.ndarray, true: np.ndarray, scale: np.ndarray | None) -> np.ndarray:
    """Return the error (H, W): mean encoded difference of an albedo (H, W, 3) after its scale, or difference of a scalar layer (H, W)."""
    if scale is None:
        return np.abs(ours - true)
    return np.abs(encode_srgb(np.clip(ours * scale, 0, 1)) - encode_srgb(np.clip(true, 0, 1))).mean(-1)
