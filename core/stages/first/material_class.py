# SPDX-License-Identifier: GPL-3.0-or-later
"""What an object may be made of, as a start and a pace for the first stage."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..common.optimizer import Rate

MOVES = ("position", "quaternion", "log_scale")  # where surfels are, how they lie and how large they are


@dataclass(frozen=True)
class MaterialClass:
    """A start that the optimisation can't leave by itself: metallic 0.5 stays 0.5, so the start needs a decision.

    Attributes:
        name: for people.
        glossy: the light is reflected by deferred split-sum; otherwise SH hold all radiance.
        material: albedo (3), roughness, metallic of the start.
        position: learning rate per scene radius. quaternion, log_scale: learning rates. What reflects turns twice as fast as
            its normal, so a metal's normals go slowly; a matt surface has little to gain from moving and scatters if it does.
    """

    name: str
    glossy: bool
    material: tuple[float, float, float, float, float]
    position: float
    quaternion: float
    log_scale: float

    def rates(self, radius: float) -> dict[str, Rate]:
        """Learning rates by parameter for a scene of this radius."""
        table = {
            "position": Rate(self.position * radius, 0.05),
            "quaternion": Rate(self.quaternion, 0.2),
            "log_scale": Rate(self.log_scale, 0.2),
            "opacity": Rate(5e-2, 0.2),
            "sh_dc": Rate(2e-2, 0.1),
            "sh_rest": Rate(1e-3, 0.1),
        }
        if self.glossy:
            table |= {"albedo": Rate(2e-2, 0.1), "roughness": Rate(2e-2, 0.1), "metallic": Rate(5e-2, 0.1), "light": Rate(3e-2, 0.2)}
        return table


LOW_GLOSS = MaterialClass("low-gloss", False, (0.5, 0.5, 0.5, 0.5, 0.02), 8e-4, 5e-4, 6e-3)
COATED = MaterialClass("glossy", True, (0.5, 0.5, 0.5, 0.4, 0.1), 1.5e-3, 2e-3, 1e-2)
METAL = MaterialClass("metal", True, (0.7, 0.7, 0.7, 0.25, 0.95), 1.2e-3, 5e-4, 1e-2)
KINDS = (LOW_GLOSS, COATED, METAL)


def candidates(materials: str) -> tuple[MaterialClass, ...]:
    """The kinds that the setting `materials` allows: auto, low-gloss or glossy."""
    return KINDS if materials == "auto" else tuple(k for k in KINDS if k.glossy == (materials == "glossy"))


def with_schedule_scale(kind: MaterialClass, other: MaterialClass) -> MaterialClass:
    """`kind` with the learning rates of `other`."""
    return replace(kind, position=other.position, quaternion=other.quaternion, log_scale=other.log_scale)
