# SPDX-License-Identifier: GPL-3.0-or-later
"""Split-sum shading: light prefiltered per roughness times the tabulated BRDF integral (Karis 2013).

A lat-long map is invariant under rotation about its axis, so that filtering is, per pair of rows, a circular convolution in azimuth: a
product in the Fourier domain. That makes it exact, differentiable and fast at any resolution.
"""

from __future__ import annotations

from functools import cache

import torch

from .brdf import base_reflectance, ggx_alpha, ggx_distribution
from .environment_lookup import lookup, solid_angles, texel_directions
from .specular_albedo import diffuse_fraction, specular_albedo

LEVELS = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)  # roughness per level of the specular stack; 0 is the map itself


@cache
def _operators_on(device: torch.device, height: int, width: int, roughness: tuple[float | None, ...]) -> torch.Tensor:
    """Return the operators of L filters side by side on a device, (W/2 + 1, H in, L x H out)."""
    return torch.cat([_operator(height, width, r) for r in roughness], 2).to(device)


@cache
def _knots(dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return LEVELS as a tensor (L,)."""
    return torch.tensor(LEVELS, dtype=dtype).to(device)


def level_roughness() -> torch.Tensor:
    """Return the roughness of each level of the specular stack, (L,) float32 on the CPU."""
    return _knots(torch.float32, torch.device("cpu"))


@cache
def _operator(height: int, width: int, roughness: float | None) -> torch.Tensor:
    """Return the Fourier transform in azimuth of a normalised filter, (W/2 + 1, H in, H out).

    Args:
        height: rows of the map.
        width: columns of the map.
        roughness: of the GGX filter with N = V = R (Karis 2013); None is the cosine filter.
    """
    out = texel_directions(height, width, torch.float64)[:, 0]  # one column per row: the filter depends on the difference of azimuths alone
    cosine = torch.einsum("oc,iwc->oiw", out, texel_directions(height, width, torch.float64)).clamp(-1, 1)
    weight = solid_angles(height, width, torch.float64)[None, :, None] * cosine.clamp_min(0)
    if roughness is not None:  # N = V = R, so n.h = cos(half the angle)
        weight = weight * ggx_distribution(((1 + cosine) / 2).sqrt(), ggx_alpha(torch.tensor(roughness, dtype=torch.float64)))
    weight = weight / weight.sum((1, 2), keepdim=True)
    # The filter is even in azimuth about column 0, so that its transform is real.
    return torch.fft.rfft(weight, dim=2).real.permute(2, 1, 0).float().contiguous()


def _filtered(light: torch.Tensor, roughness: tuple[float | None, ...]) -> torch.Tensor:
    """Apply L filters of `_operator` to a map (H, W, C): (L, H, W, C)."""
    (height, width, channels), count = light.shape, len(roughness)
    spectrum = torch.view_as_real(torch.fft.rfft(light, dim=1)).permute(1, 2, 3, 0).flatten(1, 2)
    # The few channels are the rows of the product: as its columns they would take four times as long.
    product = spectrum.contiguous() @ _operators_on(light.device, height, width, roughness)
    parts = product.unflatten(1, (channels, 2)).unflatten(3, (count, height)).permute(0, 3, 4, 1, 2)
    # A mean of values >= 0: negative results are rounding errors of the transform, next to a lamp far above 1.
    return torch.fft.irfft(torch.view_as_complex(parts.contiguous()), n=width, dim=0).permute(1, 2, 0, 3).clamp_min(0)


def diffuse_light(light: torch.Tensor) -> torch.Tensor:
    """Filter radiance (H, W, C) to irradiance / pi, (H, W, C); a constant map keeps its value."""
    return _filtered(light, (None,))[0]


def specular_light(light: torch.Tensor) -> torch.Tensor:
    """Filter radiance (H, W, C) for every roughness of LEVELS: the specular stack (L, H, W, C)."""
    return torch.cat([light[None], _filtered(light, LEVELS[1:])])


def stack_level(roughness: torch.Tensor) -> torch.Tensor:
    """Return the fractional level of the specular stack, (P,), for roughness (P,) in 0..1."""
    knots = _knots(roughness.dtype, roughness.device)
    i = torch.bucketize(roughness.detach(), knots[1:-1])
    return i + (roughness - knots[i]) / (knots[i + 1] - knots[i])


def reflect(view: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """Mirror view directions at normals, (P, 3).

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
    """
    return 2 * (view * normal).sum(-1, keepdim=True) * normal - view


def specular_radiance(
    view: torch.Tensor,
    normal: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor,
    stack: torch.Tensor,
    mirrored: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the specular part of split-sum shading, (P, 3) linear radiance.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        albedo: (P, 3) linear, 0..1.
        roughness: (P,) in 0..1.
        metallic: (P,) in 0..1.
        stack: (L, H, W, 3) of `specular_light`.
        mirrored: (P, 4) transmittance along the mirrored direction and radiance of what blocks it; None: nothing does.
    """
    n_v = (view * normal).sum(-1).clamp(1e-3, 1)
    light = lookup(stack, reflect(view, normal), stack_level(roughness))
    if mirrored is not None:
        light = mirrored[:, :1] * light + mirrored[:, 1:]
    return light * specular_albedo(n_v, roughness, base_reflectance(albedo, metallic[:, None]))


def shade(
    view: torch.Tensor,
    normal: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor,
    diffuse: torch.Tensor,
    stack: torch.Tensor,
    conserving: bool = True,
) -> torch.Tensor:
    """Return the radiance under a distant light without occlusion, (1 - m) a E(n) + specular, (P, 3) linear.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        albedo: (P, 3) linear, 0..1.
        roughness: (P,) in 0..1.
        metallic: (P,) in 0..1.
        diffuse: (H, W, 3) of `diffuse_light`.
        stack: (L, H, W, 3) of `specular_light`.
        conserving: reduce the diffuse lobe by what the specular lobe reflects, as Blender's Principled BSDF does; the paper does not.
    """
    body = (1 - metallic[:, None]) * albedo * lookup(diffuse, normal)
    if conserving:
        body = body * diffuse_fraction((view * normal).sum(-1).clamp(1e-3, 1), roughness)[:, None]
    return body + specular_radiance(view, normal, albedo, roughness, metallic, stack)
