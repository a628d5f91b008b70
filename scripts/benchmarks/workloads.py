# SPDX-License-Identifier: GPL-3.0-or-later
"""Workloads for the kernels of the rasteriser and the ray tracer: a torus of surfels, seen by a camera or by rays from its surface."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from irgspp.core.kernels.constants import NEAR, SPLAT_GRADIENTS, SPLAT_RECORD, TILE
from irgspp.core.kernels.cpu.binning import bin_tiles, depth_order
from irgspp.core.kernels.cpu.bvh import SurfelTree, flat
from irgspp.core.kernels.cpu.compositing import SH_ROW, SUMS, composite_backward_range, composite_range, pack_range
from irgspp.core.kernels.cpu.projection import project_range
from irgspp.core.kernels.cpu.raster import rasterize_backward_range, rasterize_range
from irgspp.core.kernels.cpu.trace import gather_range
from irgspp.core.kernels.rasterize import camera_numbers
from irgspp.core.kernels.trace import NORMAL, trace
from irgspp.core.machine.thread_pool import balanced_ranges, even_ranges, run_ranges, thread_count
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.gaussians import quaternion_to

from .plain_raster import plain_backward_range, plain_range
from .plain_trace import plain_composite_backward_range, plain_composite_range, plain_gather_range

EXTRAS = 4  # extra channels; with colour, normal, depth and opacity 12
MAJOR, MINOR = 1.0, 0.4  # radii of the torus
OFFSET = 0.75  # distance along secondary rays at which they start, in spacings of the surfels
OURS, PLAIN = "ours", "numba, plain loops"
RASTER = {OURS: (rasterize_range, rasterize_backward_range), PLAIN: (plain_range, plain_backward_range)}
TRACE = {
    OURS: ((gather_range, composite_range), composite_backward_range),
    PLAIN: ((plain_gather_range, plain_composite_range), plain_composite_backward_range),
}


@dataclass(frozen=True)
class Splats:
    """Projected scene and the buffers that the kernels write to; attributes as in `core/kernels/rasterize.py`."""

    start: np.ndarray
    entries: np.ndarray
    record: np.ndarray
    feature: np.ndarray
    box: np.ndarray
    columns: int
    image: np.ndarray
    gradient: np.ndarray
    stride: int
    plane: int
    slots: np.ndarray
    touched: np.ndarray
    hits: tuple[np.ndarray, np.ndarray, np.ndarray]
    tiles: list[tuple[int, int]]

    @property
    def memory(self) -> int:
        """Bytes of all arrays."""
        return sum(value.nbytes for value in (*vars(self).values(), *self.hits) if isinstance(value, np.ndarray))

    def forward(self, kernel: Callable[..., None]) -> None:
        """Fill `image` and `hits` by a forward kernel."""
        lists = self.start, self.entries, self.record, self.feature, self.box, self.columns
        run_ranges(kernel, self.tiles, *lists, self.image, self.stride, self.plane, *self.hits)

    def backward(self, kernel: Callable[..., None]) -> None:
        """Write the gradients to `slots` by a backward kernel, after a forward kernel."""
        lists, image = (
            (self.start, *self.hits, self.record, self.feature, self.columns),
            (self.image, self.gradient, self.stride, self.plane),
        )
        self.touched[:] = 0
        run_ranges(kernel, self.tiles, *lists, *image, self.slots, self.touched, numbered=True)


def torus(count: int, seed: int, extras: int = EXTRAS) -> list[np.ndarray]:
    """Return surfels all over a torus, 1 to 1.5 times as large as their spacing, opacity 0.6 to 0.99.

    Args:
        count: number of surfels.
        seed: seed of the random numbers.
        extras: extra channels.

    Returns:
        The flat float32 arguments of `project_range`: position (3 N,), quaternion (4 N,), log_scale (2 N,), opacity (N,), sh (48 N,),
        extra.
    """
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 2 * np.pi, (2, 2 * count))
    fair = rng.random(2 * count) * (MAJOR + MINOR) < MAJOR + MINOR * np.cos(b)  # uniform by area
    assert fair.sum() >= count
    a, b = a[fair][:count], b[fair][:count]
    normal = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])
    centre = MAJOR * np.stack([np.cos(a), np.sin(a), np.zeros(count)])
    spacing = math.sqrt(4 * np.pi**2 * MAJOR * MINOR / count)
    opacity = rng.uniform(0.6, 0.99, count)
    quaternion = quaternion_to(torch.from_numpy(normal)).numpy()
    scale = np.log(spacing * rng.uniform(1, 1.5, (2, count)))
    sh = rng.normal(0, 0.2, (16, 3, count))
    parts = centre + MINOR * normal, quaternion, scale, np.log(opacity / (1 - opacity)), sh, rng.random((extras, count))
    return [np.ascontiguousarray(p, np.float32).reshape(-1) for p in parts]


def viewer(size: int) -> Camera:
    """Return a camera of size x size pixels that sees the torus from 35 degrees above."""
    back = np.array([0.0, -math.cos(math.radians(35)), math.sin(math.radians(35))])
    pose = np.eye(4)
    pose[:3] = np.stack([[1, 0, 0], np.cross(back, [1, 0, 0]), back, 4 * back], -1)
    return Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, pose)


def project(count: int, size: int, seed: int = 0, extras: int = EXTRAS) -> Splats:
    """Project the torus into an image, with a random upstream gradient.

    Args:
        count: number of surfels.
        size: pixels along a side of the image.
        seed: seed of the random numbers.
        extras: extra channels.
    """
    camera = viewer(size)
    record, feature = np.empty((count, SPLAT_RECORD), np.float32), np.empty((count, 6 + extras), np.float32)
    box, depth = np.empty((count, 4), np.int32), np.empty(count, np.float32)
    camera_array = camera_numbers(camera, NEAR)
    project_range(0, -(-count // 8), *torus(count, seed, extras), 16, camera_array, count, record, feature, box, depth)
    columns = -(-size // TILE)
    start, entries = bin_tiles(depth_order(depth, box), box, columns, columns)
    stride, plane = columns * TILE, (columns * TILE) ** 2
    tiles = balanced_ranges(np.diff(start) + 1, thread_count())
    image = np.empty((9 + extras) * plane, np.float32)
    gradient = np.random.default_rng(seed).normal(size=(8 + extras) * plane).astype(np.float32)
    slots = np.zeros((len(tiles), count, -(-(SPLAT_GRADIENTS + 6 + extras) // 8) * 8), np.float32)
    hits = (np.empty_like(entries), np.empty(len(entries), np.uint8), np.empty(columns * columns, np.int32))
    outputs = (image, gradient, stride, plane, slots, np.zeros(slots.shape[:2], np.uint8), hits)
    return Splats(start, entries, record, feature, box, columns, *outputs, tiles)


@dataclass
class Rays:
    """Secondary rays and their hits; attributes as in `core/kernels/trace.py`."""

    tree: SurfelTree
    rows: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    ranges: list[tuple[int, int]]
    count: np.ndarray
    left: np.ndarray
    image: np.ndarray
    gradient: np.ndarray
    slots: np.ndarray
    hits: tuple[np.ndarray, ...] = ()

    @property
    def memory(self) -> int:
        """Bytes of all arrays, the tree's and, after `forward`, the hits' too."""
        own = [*vars(self).values(), *vars(self.tree).values(), *self.hits]
        return sum(value.nbytes for value in own if isinstance(value, np.ndarray))

    def forward(self, kernels: tuple[Callable[..., Any], Callable[..., None]]) -> None:
        """Fill `hits` and `image` by kernels that gather and composite."""
        gather, composite = kernels
        t = self.tree
        scene = t.node, t.child, t.leaf, t.index, t.depth, self.count, self.left
        parts = run_ranges(gather, self.ranges, self.origin, self.direction, *scene)
        index, weight, distance = (p[0] if len(parts) == 1 else np.concatenate(p) for p in zip(*parts, strict=True))
        start, lit = np.concatenate([[0], np.cumsum(self.count)]), np.empty(len(index), np.uint8)
        sums = start, index, weight, distance, self.left, t.record, self.rows, 16, 0, self.image, lit
        run_ranges(composite, self.ranges, self.direction, *sums)
        self.hits = start, index, weight, lit

    def backward(self, kernel: Callable[..., None]) -> None:
        """Add the gradients to `slots` by a backward kernel."""
        run_ranges(kernel, self.ranges, self.direction, *self.hits, 16, 0, self.gradient, self.slots, numbered=True)


def scatter(count: int, number: int, seed: int = 0) -> Rays:
    """Return rays over the hemispheres (cosine) of points that the camera sees, with a random upstream gradient.

    Args:
        count: number of surfels.
        number: number of rays.
        seed: seed of the random numbers.
    """
    flat_arrays = [torch.from_numpy(a) for a in torus(count, seed)]
    parameters = [a.view(*shape, count) for a, shape in zip(flat_arrays[:4], [(3,), (4,), (2,), ()], strict=True)]
    tree = SurfelTree.build(*parameters)
    camera = viewer(256)
    direction = torch.from_numpy(camera.rays().reshape(-1, 3)).float()
    direction = torch.nn.functional.normalize(direction, dim=1)
    origin = torch.from_numpy(camera.centre).float().expand_as(direction)
    seen = trace(*parameters, None, torch.empty(0, count), origin, direction, tree)
    solid = seen[:, -1] > 0.5
    point = (origin + direction * (seen[:, -2] / seen[:, -1])[:, None])[solid]
    normal = torch.nn.functional.normalize(seen[solid, NORMAL], dim=1)
    g = torch.Generator().manual_seed(seed)
    start = torch.arange(number) * len(point) // number
    direction = torch.nn.functional.normalize(torch.randn(number, 3, generator=g), dim=1) + normal[start]
    direction = torch.nn.functional.normalize(direction, dim=1)
    spacing = math.sqrt(4 * np.pi**2 * MAJOR * MINOR / count)
    rows = np.empty((count, SH_ROW), np.float32)
    pack_range(0, count, flat_arrays[4].numpy(), np.empty(0, np.float32), 16, count, rows)
    ranges = even_ranges(number, thread_count())
    gradient = torch.randn(number, SUMS, generator=g).numpy()
    slots = np.zeros((len(ranges), count, SH_ROW), np.float32)
    counts, left, image = np.zeros(number, np.int64), np.ones(number, np.float32), np.empty((number, SUMS), np.float32)
    return Rays(
        tree, rows, flat(point[start] + OFFSET * spacing * direction), flat(direction), ranges, counts, left, image, gradient, slots
    )


def disagreement(work: Splats | Rays, kernels: dict[str, Any]) -> dict[str, float]:
    """Compare two versions of the kernels, which also compiles them.

    Pixels and rays exactly on a threshold may fall to either side of it.

    Args:
        work: workload.
        kernels: forward and backward kernels by version.

    Returns:
        Largest difference of a sum ("picture"), and relative L2 difference of all gradients ("gradient").
    """
    images, gradients = [], []
    for forward, backward in kernels.values():
        work.slots[:] = 0
        work.forward(forward)
        work.backward(backward)
        images.append(work.image.copy())
        gradients.append(work.slots.sum(0, dtype=np.float64))
    relative = np.linalg.norm(gradients[0] - gradients[1]) / np.linalg.norm(gradients[1])
    return {"picture": float(np.abs(images[0] - images[1]).max()), "gradient": float(relative)}


def measure(work: Splats | Rays, kernels: dict[str, Any], repetitions: int) -> dict[str, dict[str, float]]:
    """Return the median CPU milliseconds of all threads; the versions alternate so that other load affects both alike.

    Args:
        work: workload.
        kernels: forward and backward kernels by version.
        repetitions: calls of each.

    Returns:
        Milliseconds of "forward" and "backward" by version.
    """
    times: dict[str, dict[str, list[float]]] = {name: {"forward": [], "backward": []} for name in kernels}
    for _ in range(repetitions):
        for name, (forward, backward) in kernels.items():
            work.slots[:] = 0
            began = time.process_time()
            work.forward(forward)
            middle = time.process_time()
            work.backward(backward)
            times[name]["forward"].append(1e3 * (middle - began))
            times[name]["backward"].append(1e3 * (time.process_time() - middle))
    return {name: {part: statistics.median(values) for part, values in parts.items()} for name, parts in times.items()}
