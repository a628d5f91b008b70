# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions towards lamps, drawn from surface points, and the light of a lamp along given directions, for any floating type and device.

Spheres and suns are sampled uniformly over their cone of directions, disks, rectangles and ellipses uniformly over their area. A lamp
without extent has one direction, which counts as density 1 and carries irradiance instead of radiance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..scene.lamps import Lamp
from .sampling import orthonormal_basis

NARROW = 1e-6  # least 1 - cos of a sampled cone; smaller suns count as having no extent


@dataclass(frozen=True, eq=False)
class LampLight:
    """Light of a lamp along N directions at each of P points.

    Attributes:
        direction: (P, N, 3) unit, towards the light.
        distance: (P, N) to the lamp, infinite for suns.
        density: (P, N) with which `draw_lamp` draws the direction, per steradian; 0 where it misses the lamp.
        radiance: (P, N, 3) linear, unoccluded; of a lamp without extent the irradiance.
    """

    direction: torch.Tensor
    distance: torch.Tensor
    density: torch.Tensor
    radiance: torch.Tensor


def has_extent(lamp: Lamp) -> bool:
    """Return True for a lamp that is seen under a solid angle, so that its shadows are soft."""
    return lamp.kind == "area" or (lamp.radius > 0 if lamp.kind != "sun" else 1 - math.cos(lamp.radius) > NARROW)


def draw_lamp(lamp: Lamp, origin: torch.Tensor, u: torch.Tensor) -> LampLight:
    """Draw directions towards a lamp.

    Args:
        lamp: the lamp.
        origin: (P, 3) points.
        u: (P, N, 2) uniform in [0, 1).
    """
    if lamp.kind == "area":
        drawn = _draw_area(lamp, origin, u)
    elif not has_extent(lamp):
        drawn = _only_direction(lamp, origin, u.shape[1])
    elif lamp.kind == "sun":
        drawn = _draw_cone(_axes(lamp, origin)[:, 2].expand_as(origin), _sun_cone(lamp), u)
    elif lamp.sphere:
        drawn = _draw_sphere(lamp, origin, u)
    else:
        drawn = _draw_disk(lamp, origin, u)
    return LampLight(*drawn, _radiance(lamp, origin, drawn[0]) * _falloff(lamp, origin)[..., None])


def seen_lamp(lamp: Lamp, origin: torch.Tensor, direction: torch.Tensor) -> LampLight:
    """Return the light of a lamp with extent along given directions.

    Args:
        lamp: the lamp.
        origin: (P, 3) points.
        direction: (P, N, 3) unit.
    """
    meet = _meet_area if lamp.kind == "area" else _meet_sun if lamp.kind == "sun" else _meet_sphere if lamp.sphere else _meet_disk
    distance, density = meet(lamp, origin, direction)
    radiance = torch.where(density[..., None] > 0, _radiance(lamp, origin, direction), 0.0)
    return LampLight(direction, distance, density, radiance)


def _axes(lamp: Lamp, like: torch.Tensor) -> torch.Tensor:
    """Return the lamp's unit axes as columns, (3, 3)."""
    return torch.nn.functional.normalize(like.new_tensor(lamp.matrix[:3, :3]), dim=0)


def _towards(lamp: Lamp, origin: torch.Tensor) -> torch.Tensor:
    """Return the vectors (P, 3) from points to the lamp's place."""
    return origin.new_tensor(lamp.matrix[:3, 3]) - origin


def _falloff(lamp: Lamp, origin: torch.Tensor) -> torch.Tensor:
    """Return the factor (P, 1) that makes irradiance of a lamp without extent; 1 for all others."""
    if lamp.kind in ("sun", "area") or lamp.radius > 0:
        return origin.new_ones(len(origin), 1)
    return 1 / (_towards(lamp, origin) ** 2).sum(-1, keepdim=True).clamp_min(1e-20)


def _radiance(lamp: Lamp, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Return what the lamp emits against directions (P, N, 3) that meet it, (P, N, 3)."""
    emission = origin.new_tensor(lamp.emission)
    if lamp.kind == "sun":
        factor = 1 / (math.pi * math.sin(lamp.radius) ** 2) if has_extent(lamp) else 1.0
        return (emission * factor).expand_as(direction)
    if lamp.kind == "area":
        return _spread(lamp, (direction @ _axes(lamp, origin)[:, 2]))[..., None] * emission
    emission = emission / (math.pi * lamp.radius**2) if lamp.radius > 0 else emission
    return emission.expand_as(direction) if lamp.kind == "point" else _cone(lamp, direction)[..., None] * emission


def _spread(lamp: Lamp, cosine: torch.Tensor) -> torch.Tensor:
    """Return the factor of an area lamp's radiance at the cosine to its normal, which a grid before a soft box would let through."""
    if lamp.spread > math.pi / 2 - 1e-4:
        return torch.ones_like(cosine)
    largest = math.tan(lamp.spread)
    tangent = (1 - cosine * cosine).clamp_min(0).sqrt() / cosine.clamp_min(1e-6)
    return ((largest - tangent) / (largest - lamp.spread)).clamp_min(0)


def _cone(lamp: Lamp, direction: torch.Tensor) -> torch.Tensor:
    """Return the factor of a spot's intensity against directions (P, N, 3): smooth steps from the edge of its cone inwards."""
    inverse = torch.linalg.inv(direction.new_tensor(lamp.matrix[:3, :3]))
    cosine = torch.nn.functional.normalize(direction @ inverse.T, dim=-1)[..., 2]
    edge = math.cos(lamp.cone)
    t = ((cosine - edge) / max((1 - edge) * lamp.blend, 1e-6)).clamp(0, 1)
    return t * t * (3 - 2 * t)


def _only_direction(lamp: Lamp, origin: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return direction, distance and density of a lamp without extent."""
    if lamp.kind == "sun":
        direction, distance = _axes(lamp, origin)[:, 2].expand_as(origin), origin.new_full((len(origin), 1), torch.inf)
    else:
        towards = _towards(lamp, origin)
        distance = towards.norm(dim=-1, keepdim=True).clamp_min(1e-10)
        direction = towards / distance
    direction = direction[:, None].expand(-1, count, -1)
    return direction, distance.expand(-1, count), torch.ones_like(direction[..., 0])


def _draw_cone(axis: torch.Tensor, open_: torch.Tensor | float, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Draw directions uniformly in cones about axes (P, 3) with 1 - cos = `open_`, scalar or (P, 1), at infinite distance."""
    below = u[..., 0] * open_  # 1 - cos: exact for narrow cones, unlike the cosine
    sine, phi = (below * (2 - below)).clamp_min(0).sqrt(), 2 * math.pi * u[..., 1]
    local = torch.stack([sine * phi.cos(), sine * phi.sin(), 1 - below], -1)
    density = torch.ones_like(below) / (2 * math.pi * open_)
    return torch.nn.functional.normalize(local @ orthonormal_basis(axis).mT, dim=-1), torch.full_like(density, torch.inf), density


def _sun_cone(lamp: Lamp) -> float:
    """Return 1 - cos of half a sun's angular diameter."""
    return 2 * math.sin(lamp.radius / 2) ** 2


def _meet_sun(lamp: Lamp, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return distance and density along directions (P, N, 3)."""
    axis = _axes(lamp, origin)[:, 2]
    met = (direction - axis).square().sum(-1) < 4 * math.sin(lamp.radius / 2) ** 2  # squared chord
    density = torch.where(met, 1 / (2 * math.pi * _sun_cone(lamp)), 0.0).to(direction.dtype)
    return torch.full_like(density, torch.inf), density


def _sphere_cone(lamp: Lamp, distance: torch.Tensor) -> torch.Tensor:
    """Return 1 - cos of the cone under which a sphere is seen at distances (P, 1); points inside see it from its surface."""
    sine2 = (lamp.radius / distance).square().clamp_max(1 - 1e-6)
    return sine2 / (1 + (1 - sine2).sqrt())


def _draw_sphere(lamp: Lamp, origin: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Draw directions towards a sphere; return them with distance and density."""
    towards = _towards(lamp, origin)
    distance = towards.norm(dim=-1, keepdim=True).clamp_min(1e-10)
    direction, _, density = _draw_cone(towards / distance, _sphere_cone(lamp, distance), u)
    return direction, _to_sphere(lamp, towards, direction)[0], density


def _to_sphere(lamp: Lamp, towards: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the distance to a sphere along directions (P, N, 3), and by how much the square of its radius exceeds that of the miss."""
    along = (direction * towards[:, None]).sum(-1)
    inside = lamp.radius**2 - (towards[:, None] - along[..., None] * direction).square().sum(-1)
    return (along - inside.clamp_min(0).sqrt()).clamp_min(0), torch.where(along > 0, inside, -1.0)


def _meet_sphere(lamp: Lamp, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return distance and density along directions (P, N, 3)."""
    towards = _towards(lamp, origin)
    distance, inside = _to_sphere(lamp, towards, direction)
    cone = _sphere_cone(lamp, towards.norm(dim=-1, keepdim=True).clamp_min(1e-10))
    return distance, torch.where(inside > 0, 1 / (2 * math.pi * cone), 0.0)


def _draw_disk(lamp: Lamp, origin: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Draw directions towards a disk that faces each point; return them with distance and density."""
    towards = _towards(lamp, origin)
    frame = orthonormal_basis(torch.nn.functional.normalize(towards, dim=-1))
    target = towards[:, None] + lamp.radius * (_on_disk(u) @ frame[..., :2].mT)
    distance = target.norm(dim=-1).clamp_min(1e-10)
    cosine = towards.norm(dim=-1, keepdim=True) / distance
    return target / distance[..., None], distance, distance**2 / (cosine.clamp_min(1e-6) * (math.pi * lamp.radius**2))


def _meet_disk(lamp: Lamp, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return distance and density along directions (P, N, 3)."""
    towards = _towards(lamp, origin)
    away = towards.norm(dim=-1, keepdim=True).clamp_min(1e-10)
    cosine = (direction * (towards / away)[:, None]).sum(-1)
    distance = away / cosine.clamp_min(1e-6)
    miss2 = (distance[..., None] * direction - towards[:, None]).square().sum(-1)
    met = (cosine > 1e-6) & (miss2 < lamp.radius**2)
    return distance, torch.where(met, distance**2 / (cosine.clamp_min(1e-6) * (math.pi * lamp.radius**2)), 0.0)


def _on_disk(u: torch.Tensor) -> torch.Tensor:
    """Map uniform numbers (..., 2) to points (..., 2) spread evenly over the unit disk."""
    r, phi = u[..., 0].sqrt(), 2 * math.pi * u[..., 1]
    return torch.stack([r * phi.cos(), r * phi.sin()], -1)


def _area(lamp: Lamp) -> float:
    """Return the area of an area lamp."""
    return lamp.size[0] * lamp.size[1] * (math.pi / 4 if lamp.ellipse else 1.0)


def _draw_area(lamp: Lamp, origin: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Draw directions towards an area lamp; return them with distance and density, which is 0 behind the lamp."""
    axes, half = _axes(lamp, origin), origin.new_tensor(lamp.size) / 2
    on = (_on_disk(u) if lamp.ellipse else 2 * u - 1) * half
    target = _towards(lamp, origin)[:, None] + on @ axes[:, :2].T
    distance = target.norm(dim=-1).clamp_min(1e-10)
    direction = target / distance[..., None]
    return direction, distance, _area_density(lamp, direction @ axes[:, 2], distance)


def _area_density(lamp: Lamp, cosine: torch.Tensor, distance: torch.Tensor) -> torch.Tensor:
    """Return the density of directions at cosines to the lamp's normal and distances, (P, N) each; 0 behind the lamp."""
    return torch.where(cosine > 1e-6, distance**2 / (cosine.clamp_min(1e-6) * _area(lamp)), 0.0)


def _meet_area(lamp: Lamp, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return distance and density along directions (P, N, 3)."""
    axes, towards = _axes(lamp, origin), _towards(lamp, origin)
    cosine = direction @ axes[:, 2]
    distance = (towards @ axes[:, 2])[:, None] / cosine.clamp_min(1e-6)
    on = ((distance[..., None] * direction - towards[:, None]) @ axes[:, :2]) / (origin.new_tensor(lamp.size) / 2)
    inside = on.square().sum(-1) < 1 if lamp.ellipse else on.abs().amax(-1) < 1
    met = inside & (distance > 0) & (cosine > 1e-6)
    return distance.clamp_min(0), torch.where(met, _area_density(lamp, cosine, distance), 0.0)
