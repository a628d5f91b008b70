# SPDX-License-Identifier: GPL-3.0-or-later
"""Sizes that follow from how many pixels show the object, so that its relief is represented alike in small and in large photographs."""

from __future__ import annotations

import math
from dataclasses import replace

from .schema import MOST_TEXELS, Choice, FirstStageSettings, Settings, SurfaceSettings

# Unless the settings allow fewer. On smaller objects the time is not in the number of Gaussians, voxels or triangles.
FEWEST_GAUSSIANS, FEWEST_VOXELS, FEWEST_TRIANGLES = 40_000, 192, 40_000
SURFACE_RATIO = 4.4  # area of a surface over that of its outline in the views: 3.8 to 5.0 on eight objects; 4 if convex (Cauchy 1832)
ATLAS_FRACTION = 0.52  # fraction of a texture that its charts cover: median of 33 runs, .34 to .65
# Size of a photograph over that at the working resolution, from which it may hold detail that the Gaussians don't.
MIN_SIZE_RATIO = 1.25
# Gaussians for each pixel of a full-size photograph that shows the object, below which it may do so at the working resolution, too. A print
# with 0.3 gained 5.9 dB of albedo by its photographs, with 0.7 4.4 dB; captures with 1.5 and more, and scenes with 3, lost up to 3 dB.
MIN_GAUSSIANS_PER_PIXEL = 1.0


def gaussians_at_start(first: FirstStageSettings, object_pixels: float | None) -> int:
    """Return the number of Gaussians that the first stage starts with.

    One number for all sizes leaves relief out where more pixels show the object: on igea_relief, normals were off by 4.83 degrees with
    1.3 Gaussians for each of them, 4.30 with 2.6, 4.13 with 3.9 and 4.05 with 5.2. Far more are noise: the demo's 64-pixel photographs gave
    normals off by 8.1 degrees with 200,000 Gaussians, 6.2 with 40,000.

    Args:
        first: settings; at most `gaussians`.
        object_pixels: mean number of pixels of a training view that show the object, at the working resolution; None without masks:
            twice as many Gaussians fitted the training views of such a scene better, and others worse.
    """
    if first.gaussians_per_pixel == 0:
        return first.gaussians
    if object_pixels is None:
        return min(first.gaussians, first.unmasked_gaussians)
    return min(first.gaussians, max(FEWEST_GAUSSIANS, round(first.gaussians_per_pixel * object_pixels)))


def triangles_of_mesh(surface: SurfaceSettings, object_pixels: float | None) -> int:
    """Return the largest number of triangles of the mesh.

    Shading turns normals at the mesh's vertices and the midpoints of its edges: relief that is finer than these is lost. On a stone of
    85,000 pixels, normals were off by 9.99 degrees with 0.5 triangles for each pixel, and 9.52 with 1.2; relit images gained 0.5 dB.

    Args:
        surface: settings; at most `triangles`.
        object_pixels: see `gaussians_at_start`.
    """
    if surface.triangles_per_pixel == 0:
        return surface.triangles
    if object_pixels is None:
        return min(surface.triangles, surface.unmasked_triangles)
    return min(surface.triangles, max(FEWEST_TRIANGLES, round(surface.triangles_per_pixel * object_pixels)))


def with_sizes(settings: Settings, object_pixels: float | None) -> Settings:
    """Return settings with the number of Gaussians that suits a dataset; applied twice, the same.

    Args:
        settings: of the job.
        object_pixels: see `gaussians_at_start`.
    """
    first = replace(settings.first, gaussians=gaussians_at_start(settings.first, object_pixels))
    surface = replace(settings.surface, triangles=triangles_of_mesh(settings.surface, object_pixels))
    return replace(settings, first=first, surface=surface)


def with_texture_size(settings: Settings, size: int) -> Settings:
    """Return settings with a texture size.

    Args:
        settings: of the job.
        size: texels along a side of a tile.
    """
    return replace(settings, surface=replace(settings.surface, texture=size))


def takes_photograph_detail(choice: Choice, ratio: float, per_pixel: float) -> bool:
    """Return True where the albedo texture may take detail from the full-size photographs: where the Gaussians can't hold it.

    Args:
        choice: the setting `surface.albedo_detail`.
        ratio: size of the photographs over that at the working resolution, >= 1.
        per_pixel: number of Gaussians of the object over the mean number of pixels of a full-size photograph that show it; infinity where
            it is not known.
    """
    return choice == "on" or (choice == "auto" and (ratio >= MIN_SIZE_RATIO or per_pixel < MIN_GAUSSIANS_PER_PIXEL))


def texels_along(surface: SurfaceSettings, pixels: float) -> int:
    """Return the smallest texture size (of a tile), a power of two, whose texels are about as fine as the pixels of photographs.

    Args:
        surface: settings; from `texture_least` to `texture_most`.
        pixels: mean number of pixels of a full-size photograph that show the object.
    """
    needed = math.sqrt(SURFACE_RATIO / ATLAS_FRACTION * pixels) / surface.udim_tiles
    size = surface.texture_least
    while size < needed and 2 * size <= min(surface.texture_most, MOST_TEXELS // surface.udim_tiles):
        size *= 2
    return size


def voxels_along(surface: SurfaceSettings, pixels: float) -> float:
    """Return the number of voxels along the longest side of an object.

    On igea_relief, normals were off by 4.30 degrees with voxels of .82 pixels, and 4.19 with .61.

    Args:
        surface: settings; at most `voxels`.
        pixels: length of this side in pixels of a training view.
    """
    if surface.voxel_pixels == 0:
        return surface.voxels
    return min(surface.voxels, max(FEWEST_VOXELS, pixels / surface.voxel_pixels))
