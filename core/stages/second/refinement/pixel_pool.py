# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixel pool: pixels of all training views as surface points, with the surfels along their rays; geometry is frozen, so traced once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from ....datasets.mask_limits import narrowest_mask
from ....kernels.cpu.jit import kernel
from ....kernels.trace import HitLists, Lists, hit_lists
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.camera import Camera
from ....scene.dataset import View, light_rotations
from ....scene.gaussians import Gaussians
from ....scene.surface import Surface
from ....scene.unique_rows import used_numbers
from ....surface.normal_images import normal_images
from ...common.training_view import MIN_SATURATED

TRACED_RATIO = 1.25  # pixels traced for each that is asked for
MIN_OPACITY = 0.99  # least opacity of mask and Gaussians with which a pixel counts as showing the object alone


@dataclass(frozen=True, eq=False)
class PixelPool:
    """B pixels.

    Attributes:
        lists: the Gaussians along each pixel's rays with their weights.
        opacity: (B,) accumulated opacity of each pixel, above MIN_OPACITY.
        point: (B, 3) mean of the rays' hits by weight, world.
        view: (B, 3) unit, towards the camera.
        colour: (B, 3) of the image, sRGB-encoded.
        saturated: (B, 3) bool, where the colour is a lower bound.
        number: (B,) index of the pixel's view.
        place: (B,) flat index of the pixel in its view.
        rotations: (V, 3, 3) from the world to the frame of the light of each view; None where the light stands still.
        subpixels: rays along each side of a pixel.
        views: number V of views, also of those that show no pixel.
        surface_normal: (B, 3) unit, of the fine surface, 0 where a pixel does not show it; None where there is no such surface.
    """

    lists: Lists
    opacity: torch.Tensor
    point: torch.Tensor
    view: torch.Tensor
    colour: torch.Tensor
    saturated: torch.Tensor
    number: torch.Tensor
    place: torch.Tensor
    rotations: torch.Tensor | None = None
    subpixels: int = 1
    views: int = 0
    surface_normal: torch.Tensor | None = None

    @property
    def count(self) -> int:
        """Number B of pixels."""
        return len(self.point)


def pool_pixels(views: Sequence[View], tracer: SecondaryTracer, count: int, random: np.random.Generator, subpixels: int = 1) -> PixelPool:
    """Draw pixels inside the object, equally many from each view.

    Args:
        views: images.
        tracer: tracer of the Gaussians.
        count: most pixels in all.
        random: random generator of the draw.
        subpixels: rays along each side of a pixel.
    """
    parts = [_pixels_of(view, number, tracer, max(1, count // len(views)), random, subpixels) for number, view in enumerate(views)]
    lists = join_lists([part.lists for part in parts])
    rest = [torch.cat([getattr(part, f.name) for part in parts]) for f in fields(PixelPool)[1:-4]]
    rotations = light_rotations(views)
    turned = None if rotations is None else torch.from_numpy(rotations).to(tracer.device)
    return PixelPool(lists, *rest, rotations=turned, subpixels=subpixels, views=len(views))


def with_surface_normals(pool: PixelPool, surface: Surface, cameras: Sequence[Camera]) -> PixelPool:
    """Return a pool that knows the normals of a surface at its pixels.

    Args:
        pool: pixels.
        surface: surface with vertex normals.
        cameras: cameras of the pool's views.
    """
    normal = torch.zeros_like(pool.point)
    for number, image in enumerate(normal_images(surface, cameras)):
        row = torch.nonzero(pool.number == number)[:, 0]
        normal[row] = torch.from_numpy(image).view(-1, 3).to(normal.device)[pool.place[row]]
    return replace(pool, surface_normal=normal)


def facing_side(gaussians: Gaussians, pool: PixelPool) -> torch.Tensor:
    """Find the side of each surfel that faces the cameras, by a weighted vote of the pixels that see it.

    Args:
        gaussians: N surfels.
        pool: pixels with their hit lists.

    Returns:
        (N,) +1 or -1, factor of the normal that makes it face the cameras.
    """
    towards = sums_at_surfels(pool, torch.arange(pool.count), pool.view, gaussians.count)
    vote = (gaussians.normals().detach().cpu().numpy().T * towards).sum(1)
    return torch.from_numpy(np.where(vote < 0, -1.0, 1.0).astype(np.float32)).to(pool.view.device)


def sums_at_surfels(pool: PixelPool, pixels: torch.Tensor, values: torch.Tensor, count: int) -> np.ndarray:
    """Add values of pixels to the surfels that they show, by the surfels' weights in them.

    Args:
        pool: pixels with their hit lists.
        pixels: (M,) indices in the pool.
        values: (M, C) of these pixels.
        count: number N of surfels.

    Returns:
        (N, C) float64.
    """
    arrays = pool.lists.start, pool.lists.index, pool.lists.weight, pixels, values
    total = np.zeros((count, values.shape[1]))
    add_by_weight(*(np.ascontiguousarray(torch.as_tensor(array).cpu().numpy()) for array in arrays), total)
    return total


@kernel
def add_by_weight(start, index, weight, pixels, values, total):
    """Add `values` (M, C) of the pixels `pixels` (M,) to `total` (N, C) float64 of the surfels in their hit lists, by weight."""
    for i in range(len(pixels)):
        for hit in range(start[pixels[i]], start[pixels[i] + 1]):
            for c in range(values.shape[1]):
                total[index[hit], c] += weight[hit] * values[i, c]


def _pixels_of(view: View, number: int, tracer: SecondaryTracer, count: int, random: np.random.Generator, subpixels: int) -> PixelPool:
    """Draw at most `count` pixels of one view; more are traced, as some are not opaque."""
    inside = np.ones(view.colour.shape[:2], bool) if view.alpha is None else narrowest_mask(view) > MIN_OPACITY
    index = np.sort(random.permutation(np.flatnonzero(inside))[: int(TRACED_RATIO * count)])
    origin, direction = (torch.from_numpy(a).float().to(tracer.device) for a in _pixel_rays(view.camera, index, subpixels))
    lists = merge_rays(hit_lists(tracer.tree, origin, direction), subpixels**2)
    weight, distance, length = (torch.as_tensor(a) for a in (lists.weight, lists.distance, lists.start[1:] - lists.start[:-1]))
    opacity = torch.segment_reduce(weight.double(), "sum", lengths=length, initial=0.0, unsafe=True)  # the check fails for no rays
    depth = torch.segment_reduce(weight.double() * distance, "sum", lengths=length, initial=0.0, unsafe=True) / opacity.clamp_min(1e-9)
    kept = np.flatnonzero(opacity.cpu().numpy() > MIN_OPACITY)
    kept = np.sort(random.permutation(kept)[:count])
    ray = torch.from_numpy(kept).to(tracer.device)
    colour = torch.from_numpy(view.colour.reshape(-1, 3)[index[kept]]).float().to(tracer.device)
    toward = torch.nn.functional.normalize(direction.view(len(index), subpixels**2, 3).mean(1)[ray], dim=1)
    return PixelPool(
        select_rays(lists, kept),
        opacity[ray].float(),
        origin[:1] + depth[ray].float()[:, None] * toward,
        -toward,
        colour,
        colour >= MIN_SATURATED,
        torch.full_like(ray, number),
        torch.from_numpy(index[kept]).to(tracer.device),
    )


def _pixel_rays(camera: Camera, index: np.ndarray, subpixels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and unit directions of the rays of some pixels.

    Args:
        camera: camera of the image.
        index: (B,) flat indices of pixels.
        subpixels: rays along each side of a pixel, k.

    Returns:
        (B k^2, 3) each, the rays of a pixel one after the other.
    """
    finer = camera.resized(camera.width * subpixels, camera.height * subpixels)
    row, column = (subpixels * part[:, None, None] for part in np.divmod(index, camera.width))
    row, column = row + np.arange(subpixels)[:, None], column + np.arange(subpixels)
    direction = finer.rays()[row, column].reshape(-1, 3)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.tile(camera.centre, (len(direction), 1)), direction


def merge_rays(lists: Lists, count: int) -> Lists:
    """Merge the hit lists of each `count` consecutive rays into one, whose blend is the mean of theirs."""
    if count == 1:
        return lists
    if not isinstance(lists, HitLists):
        return lists.merged(count)
    weight, left = lists.weight / np.float32(count), lists.left.reshape(-1, count).mean(1)
    return HitLists(lists.start[::count], lists.index, weight, lists.distance, left)


def select_rays(lists: Lists, rays: np.ndarray) -> Lists:
    """Select the hit lists of some rays.

    Args:
        lists: hit lists of all rays.
        rays: (R,) indices, ascending.
    """
    if not isinstance(lists, HitLists):
        return lists.chosen(torch.from_numpy(rays).to(lists.start.device))
    length = np.diff(lists.start)
    kept = np.zeros(lists.rays, bool)
    kept[rays] = True
    hits = np.repeat(kept, length)
    start = np.concatenate([[0], np.cumsum(length[kept])])
    return HitLists(start, lists.index[hits], lists.weight[hits], lists.distance[hits], lists.left[kept])


def select_rays_and_gaussians(lists: HitLists, rays: np.ndarray) -> tuple[HitLists, np.ndarray]:
    """Select the hit lists of few rays and renumber the M Gaussians that they hit.

    Args:
        lists: hit lists of all rays.
        rays: (R,) indices in any order.

    Returns:
        The lists with Gaussians numbered 0..M-1, and the Gaussians' indices (M,) in `lists`, ascending.
    """
    length = lists.start[rays + 1] - lists.start[rays]
    start = np.concatenate([[0], np.cumsum(length)])
    hits = np.repeat(lists.start[rays] - start[:-1], length) + np.arange(start[-1])
    hit, index = used_numbers(lists.index[hits])
    return HitLists(start, index.astype(np.int32), lists.weight[hits], lists.distance[hits], lists.left[rays]), hit


def join_lists(parts: Sequence[Lists]) -> Lists:
    """Concatenate the hit lists of several sets of rays."""
    if not isinstance(parts[0], HitLists):
        return parts[0].joined(parts)
    offset = np.cumsum([0] + [len(part.index) for part in parts])
    start = np.concatenate([part.start[:-1] + o for part, o in zip(parts, offset, strict=False)] + [offset[-1:]])
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in ("index", "weight", "distance", "left")]
    return HitLists(start, *columns)
