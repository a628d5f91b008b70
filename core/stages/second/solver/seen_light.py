# SPDX-License-Identifier: GPL-3.0-or-later
"""Distant light that the photographs of a capture show directly, beside the object and the near surfaces around it.

What an object reflects tells little of the light near the horizon and below it, where a table hides most. Without this, tiny bright spots
there explained what is left of the errors. The photographs also show how bright the light is, which otherwise is known only as a product
with the albedo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from ....io.srgb import decode_srgb
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import Dataset, View, light_rotations
from ....settings.schema import SecondStageSettings
from ...common.training_view import MIN_SATURATED
from .light_texels import LightTexels

PIXEL_STEP, MASK_MARGIN = 1 / 64, 1 / 100  # between the pixels that are looked at, and around the object, in longest sides of an image
MIN_TRANSMITTANCE = 0.95  # of a ray from the camera that meets neither the object nor a near surface
MIN_VIEW_PIXELS = 3  # pixels of a view in a texel
MAX_SATURATED = 0.05  # share of the pixels in a texel that may be clipped: those tell only a bound
MIN_RADIANCE = 1e-3  # linear; less is not told from it
# Standard deviation of the log radiance that a direction is taken to have besides what the views differ by: the room is not at infinity.
DEVIATION = 0.3


@dataclass(frozen=True, eq=False)
class SeenLight:
    """N pixels that show the distant light, at least one.

    Attributes:
        direction: (N, 3) unit, from the camera.
        radiance: (N, 3) linear.
        saturated: (N,) bool, where the radiance is only a lower bound.
        view: (N,) number of the pixel's view.
    """

    direction: np.ndarray
    radiance: np.ndarray
    saturated: np.ndarray
    view: np.ndarray

    def of_texels(self, texels: LightTexels) -> tuple[torch.Tensor, torch.Tensor]:
        """Average the pixels in each texel of a light.

        Args:
            texels: T texels.

        Returns:
            Weight (T,) in 0..1, how well the photographs tell a texel's light, times its solid angle over the mean of the largest texels;
            and the log radiance (T, 3). Where they do not tell, both are 0.
        """
        inside, log_radiance = texels.containing(self.direction), np.log(np.maximum(self.radiance, MIN_RADIANCE))
        number_of_views = int(self.view.max()) + 1
        by_view, count = _means(inside * number_of_views + self.view, log_radiance, texels.count * number_of_views)
        known = (count >= MIN_VIEW_PIXELS).reshape(texels.count, -1)
        views = known.sum(1)
        by_view = np.where(known[..., None], by_view.reshape(*known.shape, 3), 0)
        mean = by_view.sum(1) / np.maximum(views, 1)[:, None]
        spread = np.where(known[..., None], by_view - mean[:, None], 0)
        variance = (spread**2).sum(1).mean(1) / np.maximum(views - 1, 1)
        clipped = _means(inside, self.saturated[:, None].astype(float), texels.count)[0][:, 0]
        sure = (views > 0) & (clipped < MAX_SATURATED)
        share = texels.solid_angles * (2 * texels.height**2) / (4 * np.pi)
        weight = sure * share * DEVIATION**2 / (DEVIATION**2 + variance)
        return torch.from_numpy(weight).float(), torch.from_numpy(np.where(sure[:, None], mean, 0)).float()


def seen_light(dataset: Dataset, tracer: SecondaryTracer, settings: SecondStageSettings) -> SeenLight | None:
    """Find the pixels that show the distant light; None where no photographs outside their masks, or no near surfaces, are known.

    Args:
        dataset: training views.
        tracer: tracer of the object and its near surfaces.
        settings: settings of the second stage; without `surroundings` the tracer does not have them.
    """
    near = dataset.surroundings is not None and settings.surroundings and settings.indirect
    if not near or not dataset.has_alpha or light_rotations(dataset.train) is not None:
        return None
    return _joined([_seen_by(number, view, tracer) for number, view in enumerate(dataset.train)])


def _joined(parts: Sequence[tuple[np.ndarray, ...]]) -> SeenLight | None:
    joined = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
    return SeenLight(*joined) if len(joined[0]) else None


def _seen_by(number: int, view: View, tracer: SecondaryTracer) -> tuple[np.ndarray, ...]:
    """Return the arrays of `SeenLight` for one view."""
    camera, alpha = view.camera, view.alpha
    assert alpha is not None
    side = max(camera.width, camera.height)
    step = max(1, round(PIXEL_STEP * side))
    away = cv2.distanceTransform((alpha < 1 / 255).astype(np.uint8), cv2.DIST_L2, 3) > MASK_MARGIN * side
    row, column = (index.ravel() for index in np.mgrid[step // 2 : camera.height : step, step // 2 : camera.width : step])
    row, column = row[away[row, column]], column[away[row, column]]
    rays = camera.rays()[row, column]
    direction = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    origin = np.broadcast_to(camera.centre, direction.shape)
    ends = (torch.from_numpy(array.astype(np.float32)).to(tracer.device) for array in (origin, direction))
    free = tracer.look(*ends)[0].cpu().numpy() > MIN_TRANSMITTANCE
    colour = view.colour[row[free], column[free]]
    return direction[free], decode_srgb(colour.astype(np.float64)), (colour >= MIN_SATURATED).any(1), np.full(int(free.sum()), number)


def _means(group: np.ndarray, values: np.ndarray, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the means (G, C) of values (N, C) in each group (N,), 0 in those without any, and the number of values (G,) in each."""
    count = np.bincount(group, minlength=groups)
    sums = [np.bincount(group, channel, minlength=groups) for channel in values.T]
    return np.stack(sums, 1) / np.maximum(count, 1)[:, None], count
