# SPDX-License-Identifier: GPL-3.0-or-later
"""Material classes: initial materials and learning rates of the first stage for low-gloss, glossy (coated) and metal objects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from ...scene.gaussians import Gaussians
from ..common.optimizer import Rate

GEOMETRY_RATES = ("position", "quaternion", "log_scale")  # parameters that move, turn and scale the surfels


@dataclass(frozen=True)
class MaterialClass:
    """Initial materials that the optimisation does not leave by itself, so that they are chosen: metallic started at 0.5 stays at 0.5.

    Attributes:
        name: as shown to the user and stored in checkpoints.
        split_sum: reflections of a light map are rendered by deferred split-sum shading (Karis 2013); otherwise SH hold all radiance.
        material: initial albedo (3), roughness, metallic.
        position: learning rate per unit of scene radius.
        quaternion: learning rate. A reflection turns twice as fast as the normal, so that a metal's normals need a low rate; a matt
            surface gains little from moving and becomes noisy if it does.
        log_scale: learning rate.
        schedule: length of the schedule as a multiple of the settings'. Reflections find a metal's normals slowly, and it takes no time
            for stereo. On teapot_glossy 1, 1.7 and 2 give 4.69, 4.51 and 4.43 degrees.
        inter_reflections: the setting `first.inter_reflections` where it is None: mirrored rays matter where all is metal.
    """

    name: str
    split_sum: bool
    material: tuple[float, float, float, float, float]
    position: float
    quaternion: float
    log_scale: float
    schedule: float = 1.0
    inter_reflections: float = 1.0

    def rates(self, radius: float) -> dict[str, Rate]:
        """Return the learning rates by parameter for a scene of this radius in world units."""
        table = {  # Rate: at the start, and its factor at the end of the schedule
            "position": Rate(self.position * radius, 0.05),
            "quaternion": Rate(self.quaternion, 0.2),
            "log_scale": Rate(self.log_scale, 0.2),
            "opacity": Rate(5e-2, 0.2),
            "sh_dc": Rate(2e-2, 0.1),
            "sh_rest": Rate(1e-3, 0.1),
        }
        if self.split_sum:
            table |= {"albedo": Rate(2e-2, 0.1), "roughness": Rate(2e-2, 0.1), "metallic": Rate(5e-2, 0.1), "light": Rate(3e-2, 0.2)}
        return table


# Material, then the rates of position, quaternion and log scale:
LOW_GLOSS = MaterialClass("low-gloss", False, (0.5, 0.5, 0.5, 0.5, 0.02), 8e-4, 5e-4, 6e-3)
GLOSSY = MaterialClass("glossy", True, (0.5, 0.5, 0.5, 0.4, 0.1), 1.5e-3, 2e-3, 1e-2)
METAL = MaterialClass("metal", True, (0.7, 0.7, 0.7, 0.25, 0.95), 1.2e-3, 5e-4, 1e-2, schedule=2.0, inter_reflections=0.4)
MATERIAL_CLASSES = (LOW_GLOSS, GLOSSY, METAL)  # from the least to the most reflecting


def allowed_material_classes(materials: str) -> tuple[MaterialClass, ...]:
    """Return the material classes that the setting `materials` ("auto", "low-gloss" or "glossy") allows."""
    return MATERIAL_CLASSES if materials == "auto" else tuple(m for m in MATERIAL_CLASSES if m.split_sum == (materials == "glossy"))


def with_geometry_rates(material_class: MaterialClass, other: MaterialClass) -> MaterialClass:
    """Return a material class with the learning rates of position, quaternion and scale of another.

    Args:
        material_class: supplies everything else.
        other: supplies the three rates.
    """
    return replace(material_class, position=other.position, quaternion=other.quaternion, log_scale=other.log_scale)


def initial_materials(gaussians: Gaussians, material_class: MaterialClass, metal: torch.Tensor | None) -> torch.Tensor:
    """Return the logits (5, N) of the materials that surfels start with.

    Args:
        gaussians: N surfels.
        material_class: their class.
        metal: (N,) bool, surfels that start with the materials of METAL instead; None for none.
    """
    materials = gaussians.position.new_tensor(material_class.material)[:, None].repeat(1, gaussians.count)
    if metal is not None:
        materials[:, metal] = materials.new_tensor(METAL.material)[:, None]
    return torch.logit(materials)
