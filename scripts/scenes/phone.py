# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs as a phone takes them: held by hand, with its own exposure and white balance for each, noise and JPEG."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irgspp.core.capture import exif
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.scene.camera import Camera, look_at
from PIL import Image

FOCAL = 0.81  # in widths of an image: 29 mm on 35 mm film
ELEVATIONS = (14.0, 33.0, 56.0)  # of the rings of cameras, degrees
DISTANCE = 3.2  # of the cameras in radii of the object
UNSTEADY, OFF_CENTRE = 3.0, 0.07  # deviations of a camera's direction, degrees, and of the point that it looks at, radii of the object
STOPS, TINT = 0.45, 0.02  # largest change of the exposure, EV, and deviation of the white balance of red and blue
SHOT_NOISE, READ_NOISE = 2e-4, 4e-6  # variance of linear values, for each unit of light, and in the dark
SECONDS, F_NUMBER, ISO = 1 / 60, 1.8, 200  # of the exposure at gain 1
FILM = 36.0  # width of 35 mm film, millimetres
QUALITY = 92  # of the JPEG


@dataclass(frozen=True, eq=False)
class Shot:
    """What the phone decides for one photograph.

    Attributes:
        gain: of the exposure.
        white_balance: (3,) factors of the channels, 1 for green.
    """

    gain: float
    white_balance: np.ndarray


def handheld_cameras(count: int, centre: np.ndarray, radius: float, size: tuple[int, int], random: np.random.Generator) -> list[Camera]:
    """Return cameras on rings around an object, as a person walks around it.

    Args:
        count: number of cameras.
        centre: (3,) centre of the object.
        radius: of the object.
        size: width and height of the images, pixels.
        random: of what is not steady.
    """
    (width, height), cameras, rings = size, [], len(ELEVATIONS)
    for i in range(count):
        elevation = np.radians(ELEVATIONS[i % rings] + random.normal(0, UNSTEADY))
        azimuth = 2 * np.pi * (i // rings) / (count / rings) + 0.4 * (i % rings) + np.radians(random.normal(0, UNSTEADY))
        away = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        target = centre + OFF_CENTRE * radius * random.normal(size=3)
        pose = look_at(centre + DISTANCE * radius * away, target)
        cameras.append(Camera(width, height, FOCAL * width, FOCAL * width, width / 2, height / 2, pose))
    return cameras


def draw_shot(random: np.random.Generator) -> Shot:
    """Draw exposure and white balance of a photograph."""
    red, blue = 1 + TINT * random.normal(size=2)
    return Shot(float(2 ** random.uniform(-STOPS, STOPS)), np.array([red, 1.0, blue]))


def save_photograph(path: Path, radiance: np.ndarray, shot: Shot, random: np.random.Generator) -> None:
    """Write a JPEG with noise, and EXIF that tells its exposure and focal length.

    Args:
        path: file to write.
        radiance: (H, W, 3) linear.
        shot: exposure and white balance.
        random: of the noise.
    """
    light = np.maximum(radiance, 0) * shot.gain * shot.white_balance
    light = light + random.normal(size=light.shape) * np.sqrt(SHOT_NOISE * light + READ_NOISE)
    image = Image.fromarray(np.round(255 * encode_srgb(np.clip(light, 0, 1))).astype(np.uint8))
    tags = image.getexif()
    tags[exif.MAKE], tags[exif.MODEL] = "irgspp", "rendered"
    taken = {exif.EXPOSURE_TIME: SECONDS * shot.gain, exif.F_NUMBER: F_NUMBER, exif.ISO: ISO, exif.FOCAL_35: round(FOCAL * FILM)}
    tags.get_ifd(exif.EXIF_IFD).update(taken)
    image.save(path, quality=QUALITY, exif=tags)
