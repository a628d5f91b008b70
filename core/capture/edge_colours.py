# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours on both sides of the object's edge in a photograph: the object's as rendered, and the background's as other views show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..io.continued_colour import continued_colour
from ..io.grown_mask import grown_mask
from ..scene.camera import Camera
from .background_evidence import plane_in_photograph
from .likelihood_ratio import log_likelihood_ratios
from .plane_texture import PlaneTexture

INNER, OUTER = 1.5, 2.0  # errors of a mask from its edge, from which pixels are surely the object, and surely the background
MIN_RENDERED_OPACITY = 0.9  # rendered opacity from which the rendered colour is the object's
OUTLINE_CLEARANCE = 1.0  # errors of a mask that this colour keeps from the rendered outline
OBJECT_WINDOW, BACKGROUND_WINDOW = 0.75, 1.5  # sigmas, in errors of a mask, of the windows from which both colours are continued
MAX_WINDOWS = 4  # tried; each is twice as wide
MAX_DIFFERENCE = 0.5  # difference in the last bin of the histograms, encoded
HALF_RELIABLE_CONTRAST = 0.02  # squared distance of both colours, encoded, at which the coverage counts half


@dataclass(frozen=True, eq=False)
class EdgeColours:
    """How a photograph differs from the object and from the background around the object's edge.

    Attributes:
        from_object: (H, W) float32, largest difference of a channel from the object's colour, encoded.
        from_background: (H, W) float32, the same from the background's colour.
        coverage: (H, W) float32 0..1, fraction of a pixel that the object covers: where its colour lies between both.
        reliability: (H, W) float32 0..1 of the coverage, near 1 where both colours are far apart.
        inside: (H, W) bool, surely the object.
        outside: (H, W) bool, surely the background.
        textured: (H, W) bool, the background's colour is that of the support plane.
    """

    from_object: np.ndarray
    from_background: np.ndarray
    coverage: np.ndarray
    reliability: np.ndarray
    inside: np.ndarray
    outside: np.ndarray
    textured: np.ndarray


def edge_colours(
    texture: PlaneTexture, colour: np.ndarray, camera: Camera, mask: np.ndarray, rendered: tuple[np.ndarray, np.ndarray], error: float
) -> EdgeColours:
    """Compare a photograph with the rendered object and with the background.

    Args:
        texture: texture of the support plane.
        colour: (H, W, 3) float32 sRGB-encoded photograph.
        camera: camera of the photograph.
        mask: (H, W) 0..1.
        rendered: straight colour (H, W, 3) of the object, encoded, and its opacity (H, W).
        error: error of the mask's edge, pixels.
    """
    filled, shown = (mask > 0.5).astype(np.uint8), (rendered[1] > 0.5).astype(np.uint8)
    inside, outside = grown_mask(filled, -INNER * error) > 0, grown_mask(filled, OUTER * error) == 0
    solid = (rendered[1] > MIN_RENDERED_OPACITY) & (grown_mask(shown, -OUTLINE_CLEARANCE * error) > 0)
    own = continued_colour(rendered[0], solid, OBJECT_WINDOW * error, MAX_WINDOWS)
    plane, textured = plane_in_photograph(texture, colour, camera, outside)
    background = np.where(textured[..., None], plane, continued_colour(colour, outside, BACKGROUND_WINDOW * error, MAX_WINDOWS))
    from_object, from_background = (np.abs(colour - other).max(-1).astype(np.float32) for other in (own, background))
    coverage, reliability = _coverage(colour, own, background)
    return EdgeColours(from_object, from_background, coverage, reliability, inside, outside, textured)


def _coverage(colour: np.ndarray, own: np.ndarray, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the coverage and its reliability, see `EdgeColours`; colour, own, background: (H, W, 3), encoded."""
    between = own - background
    contrast = np.square(between).sum(-1)
    coverage = ((colour - background) * between).sum(-1) / np.maximum(contrast, np.float32(1e-8))
    return np.clip(coverage, 0, 1).astype(np.float32), (contrast / (contrast + HALF_RELIABLE_CONTRAST)).astype(np.float32)


def edge_evidence(views: Sequence[EdgeColours]) -> list[np.ndarray]:
    """Return the log-likelihood ratio (H, W) float32 of background to object in each view.

    How much both differ from their colours is learned from the pixels that are sure.
    """
    plane = [one.outside & one.textured for one in views]
    inside = [one.inside for one in views]
    background = log_likelihood_ratios([one.from_background for one in views], plane, inside, MAX_DIFFERENCE)
    return [first + second for first, second in zip(object_evidence(views), background, strict=True)]


def object_evidence(views: Sequence[EdgeColours]) -> list[np.ndarray]:
    """Return the same ratio by the object's colours alone: < 0 where a photograph shows them."""
    outside, inside = [one.outside for one in views], [one.inside for one in views]
    return log_likelihood_ratios([one.from_object for one in views], outside, inside, MAX_DIFFERENCE)
