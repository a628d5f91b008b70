# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of the images at Gaussians, with colours sharper than pixels.

The SH of a Gaussian are fitted to all images, so they hold finer detail than a pixel of one image does. The colour of a sample is:

- for an object without reflections, whose SH hold all radiance: the SH of the Gaussian;
- for a glossy object, whose SH hold the diffuse part only: the colour C of the pixel plus the detail (1 - m) (c_i - C_sh). Here m is the
  Gaussian's metallic, c_i its SH, and C_sh the SH of all Gaussians rendered at that pixel. The reflection stays the pixel's.

Without this detail, the albedo of a glossy bowl with a fine pattern had 2 dB less.

Detail of a glossy object that differs in brightness alone is not used where the mesh has relief: it is more likely the shading of a relief
finer than the normals than pigment (Retinex, Land and McCann 1971). With it, the albedo of a stone face had 2 dB less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ....io.srgb import encode_srgb
from ....kernels.rasterize import rasterize
from ....rendering.deferred import splat_radiance
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.camera import Camera
from ....scene.dataset import View
from ....scene.gaussians import METALLIC
from ....scene.reconstruction import Reconstruction
from ....scene.spherical_harmonics import sh_radiance
from ...common.nearest_neighbours import nearest_neighbours
from .multi_view_samples import MultiViewSamples, sample_images
from .view_choice import choose_views

MAX_VIEWS = 4  # samples of each Gaussian, at most
NEIGHBOURS = 64  # nearest points over which the colour of the detail is averaged
# Share of colour in the detail from which it begins to count as pigment, and from which all of it does. Its median over the surface was .28
# on the stone face (igea_relief), and .46 to .75 on five objects with patterns of colour.
MIN_COLOUR_SHARE, FULL_COLOUR_SHARE = 0.3, 0.45
MIN_RADIANCE, MAX_RATIO = 0.02, 1.0  # least radiance that detail is divided by, and largest ratio that counts


def sharp_samples(
    reconstruction: Reconstruction,
    normal: np.ndarray,
    views: Sequence[View],
    tracer: SecondaryTracer,
    seed: int,
    subpixels: int,
    paint: np.ndarray | None = None,
) -> MultiViewSamples:
    """Sample the images at the Gaussians that they show.

    Args:
        reconstruction: N Gaussians with the radiance that was fitted.
        normal: (N, 3) float32 unit normals of the surface.
        views: training images.
        tracer: tracer of the Gaussians.
        seed: seed of the random choice of views.
        subpixels: rays along each side of a pixel with which the radiance was fitted.
        paint: (N,) 0..1, how much of the radiance's variation around each is paint as the mesh has no such relief; None: unknown.
    """
    g, mirrored = reconstruction.gaussians, reconstruction.mirrored()
    position = g.position.T.contiguous().cpu().numpy()
    random, device = np.random.default_rng(seed), g.position.device
    choice = choose_views(position, normal, views, tracer, random, most=MAX_VIEWS, least=1)
    chosen = torch.from_numpy(choice.chosen).to(device)
    samples = sample_images(position, normal, views, (view.colour for view in views), choice, device)
    own = sh_radiance(g.sh[:, :, chosen[samples.point]], samples.view.T).T.contiguous()
    if mirrored is None:
        return replace(samples, colour=own)
    images = (sh_image(reconstruction, view.camera, subpixels) for view in views)
    blurred = sample_images(position, normal, views, images, choice, device)
    detail = (1 - mirrored.material[METALLIC, chosen[samples.point], None]) * (own - blurred.colour)
    share = pigment_share(samples, detail)
    if paint is not None:
        share = torch.maximum(share, torch.from_numpy(paint).to(detail)[chosen])
    detail = share[samples.point, None] * detail
    return replace(samples, colour=(samples.colour + detail).clamp_min(0))


def pigment_share(samples: MultiViewSamples, detail: torch.Tensor) -> torch.Tensor:
    """Return how far the detail around each point is one of pigments, (P,) in 0..1, by the share of colour in it.

    Args:
        samples: K samples of P points.
        detail: (K, 3) linear radiance that is to be added to their colours.
    """
    ratio = samples.sums(detail / samples.colour.clamp_min(MIN_RADIANCE)) / samples.lengths[:, None]
    coloured = ratio - ratio.mean(1, keepdim=True)
    size = torch.stack([coloured, ratio]).abs().clamp_max(MAX_RATIO).sum(2)
    colour, whole = size[:, nearest_neighbours(samples.position, samples.position, NEIGHBOURS)].mean(2)
    return ((colour / whole.clamp_min(1e-6) - MIN_COLOUR_SHARE) / (FULL_COLOUR_SHARE - MIN_COLOUR_SHARE)).clamp(0, 1)


def sh_image(reconstruction: Reconstruction, camera: Camera, subpixels: int) -> np.ndarray:
    """Render the SH of a reconstruction without reflections, as an image (H, W, 3) sRGB-encoded, above 1 where they are."""
    g = reconstruction.gaussians
    none = g.position.new_zeros(0, g.count)
    parameters = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, none)
    sums, _ = rasterize(*parameters, camera, reconstruction.bound.radius, subpixels=subpixels)
    return encode_srgb(splat_radiance(sums)).permute(1, 2, 0).cpu().numpy()
