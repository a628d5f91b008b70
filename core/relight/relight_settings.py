# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of relit images."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ..settings.schema import Brdf, SkipSettings
from .sample_counts import Proportions


@dataclass(frozen=True)
class RelightSettings:
    """Settings of a relit image.

    Attributes:
        samples: "hq", "efficient" or the number of samples per pixel.
        sampling: "mis", or "stratified" for comparison.
        denoise: "demodulated", "paper" or "off".
        indirect: add the light that other parts of the object reflect; without it they only cast shadows.
        transfer: these parts receive light with shadows and interreflections, see `VertexTransfer`, where there is a mesh; False: the
            unoccluded light (the paper).
        conserving: reduce the diffuse lobe by what the specular lobe reflects (Blender's Principled BSDF); False: do not (the paper);
            None: as is usual for the BRDF, which is not for IRGS'.
        mesh_normals: weight of the mesh's normals (those of its texture) in the shading normals, 0..1, where there is a mesh;
            None: as is best for the object's material.
        albedo_scale: factor of the albedo per channel: under an unknown light its brightness cannot be determined.
        skip: `reuse_visibility` ("off": every ray is traced) and `cache_rays` ("off": nothing is kept from light to light), see
            `SkipSettings`.
        error: root-mean-square error of the sRGB image to reach; the image's noise (`image_noise.py`) then tells the number of samples per
            pixel. None: `samples` tells it.
        allocation: proportions of cosine, visible-normal and light samples; None: by the object's material.
        shadows: other parts of the object hide the light; False: for comparison, they only reflect.
        ratio: the diffuse light's unoccluded part is known and not sampled, see `estimate_reflected_light`; False: it is (the paper).
        divide: shade the rays of a pixel apart where the surface bends within it, see `DividedHits`. False: one point per pixel (the
            paper).
        brdf: reflectance model; None: that of the reconstruction, which its materials were fitted with.
    """

    samples: str | int = "hq"
    sampling: Literal["mis", "stratified"] = "mis"
    denoise: Literal["demodulated", "paper", "off"] = "demodulated"
    indirect: bool = True
    transfer: bool = True
    conserving: bool | None = None
    mesh_normals: float | None = None
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    skip: SkipSettings = field(default_factory=SkipSettings)
    error: float | None = None
    allocation: Proportions | None = None
    shadows: bool = True
    ratio: bool = True
    divide: bool = True
    brdf: Brdf | None = None
