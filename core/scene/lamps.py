# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps: sources of light at a place or at infinite distance, with Blender's and Cycles' radiometry.

A lamp shines along the -Z axis of its own frame. Only numpy is used: the module also runs in Blender's process.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from ..errors import InputError

Kind = Literal["sun", "point", "spot", "area"]
RIGHT_ANGLE = math.pi / 2 + 1e-6  # with the rounding of Blender's float32 angles
IDENTITY = tuple(np.eye(4).reshape(-1).tolist())


@dataclass(frozen=True)
class Lamp:
    """Lamp in a world.

    Attributes:
        kind: sun (infinitely distant), point, spot (point with a cone) or area (rectangle or ellipse).
        to_world: (16,) row-major matrix from the lamp's frame to the world.
        emission: linear RGB. Sun: irradiance of a surface that faces it, W/m^2; point and spot: radiant intensity on the axis, W/sr; area:
            radiance along its normal, W/(m^2 sr).
        radius: of point and spot lamps, world units; of a sun, half its angular diameter in radians. 0: hard shadows.
        size: width and height of an area lamp along its X and Y axes, world units.
        ellipse: True for an elliptic area lamp.
        cone: angle between a spot's axis and the edge of its cone, radians.
        blend: fraction of the cone over which its edge is smoothed, 0..1.
        spread: largest angle from its normal at which an area lamp emits, radians; pi / 2: a diffuse emitter.
        sphere: True for a spherical point or spot lamp, False for a disk that faces whatever it lights.
        shadow: False for light that passes through everything.
    """

    kind: Kind
    to_world: tuple[float, ...] = IDENTITY
    emission: tuple[float, float, float] = (1.0, 1.0, 1.0)
    radius: float = 0.0
    size: tuple[float, float] = (0.0, 0.0)
    ellipse: bool = False
    cone: float = math.pi / 4
    blend: float = 0.0
    spread: float = math.pi / 2
    sphere: bool = True
    shadow: bool = True

    @property
    def matrix(self) -> np.ndarray:
        """Return `to_world` as (4, 4) float64."""
        return np.array(self.to_world, float).reshape(4, 4)

    def moved(self, step: np.ndarray) -> Lamp:
        """Return the lamp in another frame: irradiances and radiances stay.

        Args:
            step: (4, 4) similarity from the present world to the other.
        """
        scale = float(np.cbrt(np.linalg.det(step[:3, :3])))
        placed = replace(self, to_world=tuple((step @ self.matrix).reshape(-1).tolist()), size=(self.size[0] * scale, self.size[1] * scale))
        if self.kind in ("sun", "area"):
            return placed
        red, green, blue = (value * scale**2 for value in self.emission)
        return replace(placed, radius=self.radius * scale, emission=(red, green, blue))


def lamp_records(lamps: Sequence[Lamp]) -> list[dict[str, Any]]:
    """Return lamps as JSON values, which `read_lamps` reads."""
    return [asdict(lamp) for lamp in lamps]


def read_lamps(values: Any) -> tuple[Lamp, ...]:
    """Read lamps from JSON values.

    Args:
        values: list of objects with the attributes of `Lamp`; all but `kind` may be left out.

    Raises:
        InputError: when something is missing, unknown or out of range.
    """
    if not isinstance(values, list | tuple):
        raise InputError("lamps", "is not a list", "write a list of objects with the attributes of a lamp")
    return tuple(_lamp(number, value) for number, value in enumerate(values))


def _lamp(number: int, values: Any) -> Lamp:
    """Return one lamp; raise InputError where it is invalid."""
    known = {field.name: field for field in fields(Lamp)}
    try:
        if unknown := set(values) - set(known):
            raise ValueError(f"{', '.join(sorted(unknown))} is unknown")
        lamp = Lamp(**{name: _value(name, value) for name, value in values.items()})
        _check(lamp)
    except (TypeError, ValueError) as error:
        raise InputError(f"lamp {number}", f"can't be understood ({error})", f"it has the attributes {', '.join(known)}") from error
    return lamp


def _value(name: str, value: Any) -> Any:
    """Return an attribute's JSON value with the attribute's type."""
    if name == "kind":
        return value
    if name in ("to_world", "emission", "size"):
        return tuple(float(number) for number in value)
    return bool(value) if name in ("ellipse", "sphere", "shadow") else float(value)


def _check(lamp: Lamp) -> None:
    """Raise ValueError where an attribute is out of range."""
    if lamp.kind not in get_args(Kind):
        raise ValueError(f"kind {lamp.kind} must be one of {', '.join(get_args(Kind))}")
    lengths = (len(lamp.to_world), len(lamp.emission), len(lamp.size))
    if lengths != (16, 3, 2):
        raise ValueError(f"to_world, emission and size must have 16, 3 and 2 numbers, got {lengths}")
    numbers = (*lamp.to_world, *lamp.emission, *lamp.size, lamp.radius, lamp.cone, lamp.blend, lamp.spread)
    if not np.isfinite(numbers).all():
        raise ValueError("all numbers must be finite")
    if min(*lamp.emission, *lamp.size, lamp.radius) < 0 or not 0 <= lamp.blend <= 1:
        raise ValueError("emission, size and radius must be at least 0, blend from 0 to 1")
    if lamp.kind == "area" and not min(lamp.size):
        raise ValueError("an area lamp must have a size")
    if not (0 < lamp.cone <= math.pi and 0 < lamp.spread <= RIGHT_ANGLE):
        raise ValueError("cone must be above 0 and at most pi, spread at most pi / 2")
    if lamp.kind == "sun" and lamp.radius > RIGHT_ANGLE:
        raise ValueError("the radius of a sun must be at most pi / 2")
    if abs(np.linalg.det(lamp.matrix[:3, :3])) < 1e-30:
        raise ValueError("to_world has no inverse")
