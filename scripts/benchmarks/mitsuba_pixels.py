# SPDX-License-Identifier: GPL-3.0-or-later
"""Mitsuba sensor whose image consists of single pixels of many photographs; imported once a variant is set."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportArgumentType=false
# (Mitsuba is optional, and its types depend on the variant)

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


class PixelSensor(mi.Sensor):
    """Sensor whose film has one pixel for each pixel chosen last by `choose`."""

    def __init__(self, props: mi.Properties) -> None:
        mi.Sensor.__init__(self, props)
        self.m_needs_sample_3 = False
        self.rows = self.film().size()[1]

    @classmethod
    def make(cls, arrays: dict[str, np.ndarray], pixels: int) -> PixelSensor:
        """Return a sensor for the pixels of a pool.

        Args:
            arrays: of each pixel pixel_view (K,) and pixel_place (K, 2), column and row; of each view view_origin, view_corner, view_right
                and view_down (N, 3), from which the ray through column x, row y is origin and corner + x right + y down.
            pixels: pixels at once, a square number.

        Raises:
            ValueError: where `pixels` is not a square number.
        """
        side = round(pixels**0.5)
        if side * side != pixels:
            raise ValueError(f"{pixels} is not a square number")
        film: dict[str, Any] = {"type": "hdrfilm", "width": side, "height": side, "pixel_format": "rgb", "rfilter": {"type": "box"}}
        properties = mi.Properties()
        properties["film"], properties["sampler"] = mi.load_dict(film), mi.load_dict({"type": "multijitter"})
        one = cls(properties)
        one.view, one.place = mi.UInt32(arrays["pixel_view"]), mi.Point2f(np.ascontiguousarray(arrays["pixel_place"].T))
        names = ("origin", "corner", "right", "down")
        one.lens = [mi.Vector3f(np.ascontiguousarray(arrays[f"view_{name}"].T)) for name in names]
        return one

    def choose(self, chosen: np.ndarray) -> None:
        """Choose the pixels of the next image.

        Args:
            chosen: (N,) indices into the pool, row by row of the film.
        """
        self.chosen = mi.UInt32(chosen)

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """Draw a ray through a random point of a chosen pixel (Mitsuba's interface of a sensor).

        Args:
            time: time of the ray.
            sample1: random number, unused.
            sample2: random point on the film, (2,) in 0..1.
            sample3: random point on the aperture, unused.
            active: mask of the lanes.

        Returns:
            The ray, and its weight 1.
        """
        on_film = sample2 * self.rows
        corner = dr.floor(on_film)
        slot = mi.UInt32(corner.y) * self.rows + mi.UInt32(corner.x)
        pixel = dr.gather(mi.UInt32, self.chosen, slot)
        at = dr.gather(mi.Point2f, self.place, pixel) + on_film - corner
        view = dr.gather(mi.UInt32, self.view, pixel)
        origin, first, right, down = (dr.gather(mi.Vector3f, value, view) for value in self.lens)
        return mi.Ray3f(mi.Point3f(origin), dr.normalize(first + at.x * right + at.y * down), time, []), mi.Color3f(1.0)

    def sample_ray_differential(self, time, sample1, sample2, sample3, active=True):
        """Draw a ray as `sample_ray` does, without differentials: no texture here is filtered.

        Args:
            time: time of the ray.
            sample1: random number, unused.
            sample2: random point on the film, (2,) in 0..1.
            sample3: random point on the aperture, unused.
            active: mask of the lanes.

        Returns:
            The ray, and its weight 1.
        """
        ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """Return the plugin's name, as Mitsuba prints it."""
        return "PixelSensor[]"
