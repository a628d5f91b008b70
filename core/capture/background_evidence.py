# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence that pixels show the support plane: how well they agree with its texture."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..scene.camera import Camera
from ..scene.dataset import Bound
from .likelihood_ratio import log_likelihood_ratios
from .plane_texture import PlaneTexture
from .support_plane import SupportPlane

LOCAL_SIGMA = 0.02  # sigma of the window in which a photograph's own brightness of the plane is measured, in the image's longest sides
REDUCTION = 4  # factor by which images are reduced for that
WIDER_FACTOR = 4.0  # factor of that window where nothing of the plane is near
MAX_BRIGHTNESS_RATIO = 4.0  # of that brightness to the texture's
MAX_DIFFERENCE = 0.8  # difference in the last bin of the histograms, encoded
SURE_PRIOR = 0.1  # prior below which a pixel counts as the background, and above 1 - SURE_PRIOR as the object
MAX_LOG_RATIO = 4.0  # largest log-likelihood ratio


def plane_differences(texture: PlaneTexture, colour: np.ndarray, camera: Camera, prior: np.ndarray) -> np.ndarray:
    """Return how much pixels differ from the plane's texture: (H, W) float32 encoded, NaN where the texture is not known.

    The plane shines and lies in shadow differently in each photograph, so the texture is first brought to the photograph's brightness
    around each pixel, measured outside the object.

    Args:
        texture: texture of the plane.
        colour: (H, W, 3) float32 sRGB-encoded photograph.
        camera: camera of the photograph.
        prior: (H, W) 0..1, how surely a pixel is the object.
    """
    plane, known = plane_in_photograph(texture, colour, camera, prior < SURE_PRIOR)
    return np.where(known, np.abs(colour - plane).max(-1), np.nan).astype(np.float32)


def plane_in_photograph(texture: PlaneTexture, colour: np.ndarray, camera: Camera, outside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the plane's colours (H, W, 3), brought to a photograph's brightness, and (H, W) bool where they are known.

    Args:
        texture: texture of the plane.
        colour: (H, W, 3) float32 sRGB-encoded photograph.
        camera: camera of the photograph.
        outside: (H, W) bool, pixels that are not the object.
    """
    plane, known = texture.seen_by(camera)
    return plane * _ratio(colour, plane, (known & outside).astype(np.float32)), known


def _ratio(colour: np.ndarray, plane: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Return the photograph's brightness over the texture's (H, W, 3), averaged around each pixel over what is `outside`."""
    height, width = outside.shape
    small = max(width // REDUCTION, 1), max(height // REDUCTION, 1)
    shown = [cv2.resize(image * outside[..., None], small, interpolation=cv2.INTER_AREA) for image in (colour, plane)]
    size, weight = LOCAL_SIGMA * max(small), cv2.resize(outside, small, interpolation=cv2.INTER_AREA)
    near, wide = (np.divide(*(cv2.GaussianBlur(image, (0, 0), sigma) + 1e-4 for image in shown)) for sigma in (size, WIDER_FACTOR * size))
    trust = np.minimum(1, 20 * cv2.GaussianBlur(weight, (0, 0), size))[..., None]
    ratio = np.clip(trust * near + (1 - trust) * wide, 1 / MAX_BRIGHTNESS_RATIO, MAX_BRIGHTNESS_RATIO)
    return cv2.resize(ratio, (width, height), interpolation=cv2.INTER_LINEAR)


def background_evidence(differences: Sequence[np.ndarray], priors: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the log-likelihood ratio (H, W) of background to object for the differences of each view; 0 where nothing is known.

    How much the plane and the object differ from the texture is learned from the pixels that are sure already. An object of the table's
    colours gives no evidence.

    Args:
        differences: (H, W) of each view, as of `plane_differences`.
        priors: (H, W) 0..1 of each view, how surely a pixel is the object.
    """
    background, inside = [prior < SURE_PRIOR for prior in priors], [prior > 1 - SURE_PRIOR for prior in priors]
    return [np.clip(one, -MAX_LOG_RATIO, MAX_LOG_RATIO) for one in log_likelihood_ratios(differences, background, inside, MAX_DIFFERENCE)]


def beyond_plane(evidence: np.ndarray, camera: Camera, plane: SupportPlane, bound: Bound) -> np.ndarray:
    """Return the pixels (H, W) bool whose background can't be the support plane: no texture of it is known, and the object hides none.

    Args:
        evidence: (H, W), as of `background_evidence`.
        camera: camera of the view.
        plane: plane that the object stands on.
        bound: sphere about the object; what it hides of the plane lies within its radius from its foot.
    """
    rays, centre = camera.rays(), np.asarray(bound.centre)
    falling = np.minimum(rays @ plane.normal, -1e-6)
    depth = -plane.height(camera.centre) / falling
    foot = centre - plane.height(centre) * plane.normal
    near = np.linalg.norm(camera.centre + depth[..., None] * rays - foot, axis=-1) < bound.radius
    return (evidence == 0) & ~near
