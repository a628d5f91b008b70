# SPDX-License-Identifier: GPL-3.0-or-later
"""Conditions of a report in words: how its images were rendered, which views are in it, and what was missing."""

from __future__ import annotations

from collections.abc import Sequence

from ..relight.backends import Backend
from ..relight.relight_settings import RelightSettings
from ..settings.schema import Brdf
from .cases import Cases
from .image_metrics import LpipsBySuffix
from .lpips import NO_LPIPS
from .protocols import Protocol


def describe_renderer(relight: RelightSettings, backend: Backend, brdf: Brdf) -> str:
    """Describe how images were rendered, in words for a report.

    Args:
        relight: settings of the images.
        backend: what secondary rays are traced on.
        brdf: reflectance model.
    """
    denoised = {"demodulated": "denoised", "paper": "denoised as in the paper", "off": "not denoised"}[relight.denoise]
    parts = [f"{relight.samples} samples per pixel", f"{backend} backend", denoised]
    parts += ["strata of the hemisphere"] if relight.sampling == "stratified" else []
    parts += [f"proportions {':'.join(map(str, relight.allocation))}"] if relight.allocation else []
    if not relight.indirect:
        parts.append("without indirect light")
    elif not relight.transfer:
        parts.append("indirect light without shadows")
    parts += [] if relight.shadows else ["without shadows"]
    parts += [] if relight.ratio else ["without the known irradiance"]
    parts += [] if relight.divide else ["one point per pixel"]
    parts += [] if relight.mesh_normals is None else [f"mesh normals {relight.mesh_normals:g}"]
    parts += ["IRGS' BRDF"] if brdf == "irgs" else ["Lambertian diffuse lobe"] if relight.conserving is False else []
    return ", ".join(parts)


def describe_conditions(cases: Cases, protocol: Protocol, lpips: LpipsBySuffix, scale: Sequence[float] | None, renderer: str) -> list[str]:
    """Describe in lines of text under which conditions the images of a report were rendered.

    Args:
        cases: views that are compared.
        protocol: of the comparison.
        lpips: perceptual distances.
        scale: (3,) of the albedo; None where each view has its own, or none is known.
        renderer: from `describe_renderer`.
    """
    unscaled = "its view's own" if protocol.scale_each_view else "as estimated (no true albedo is known)"
    factors = unscaled if scale is None else "times " + " ".join(f"{s:.4f}" for s in scale)
    lines = [
        f"Shaded and relit images: {renderer}.",
        f"Scale of the albedo: albedo {factors}.",
        f"LPIPS: {', '.join(one.name for one in lpips.values())}." if lpips else NO_LPIPS,
    ]
    if novel := len(cases.views) - cases.own:
        lines.append(f"{novel} of {cases.novel} views are photographs under other lights, which only relit images are compared with.")
    if cases.own < cases.of:
        lines.append(f"Only {cases.own} of the {cases.of} {cases.split} views, evenly spread: published tables are of all.")
    return lines
