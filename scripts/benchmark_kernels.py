# SPDX-License-Identifier: GPL-3.0-or-later
"""Time the rasteriser's kernels, forward and backward, against the same algorithm in plain scalar loops."""

# pyright: reportMissingImports=false
# (`irgspp` is the folder above, known to pyright under no name)

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from irgspp.core.datasets.camera import Camera
from irgspp.core.kernels.binning import TILE, bin_tiles, depth_order
from irgspp.core.kernels.pool import balanced_ranges, run_ranges, thread_count
from irgspp.core.kernels.projection import GEOMETRY, NEAR, RECORD, project_range
from irgspp.core.kernels.raster import rasterize_backward_range, rasterize_range
from irgspp.core.kernels.rasterize import camera_numbers
from irgspp.core.scene.gaussians import quaternion_to
from plain_raster import plain_backward_range, plain_range

EXTRAS = 4  # with colour, normal, depth and opacity: 12 channels
MAJOR, MINOR = 1.0, 0.4  # radii of the torus
KERNELS = {"vector": (rasterize_range, rasterize_backward_range), "plain": (plain_range, plain_backward_range)}


@dataclass(frozen=True)
class Splats:
    """A projected scene, and what the kernels write to; attributes as in `core/kernels/rasterize.py`."""

    start: np.ndarray
    entries: np.ndarray
    record: np.ndarray
    feature: np.ndarray
    box: np.ndarray
    columns: int
    picture: np.ndarray
    gradient: np.ndarray
    stride: int
    plane: int
    slots: np.ndarray
    tiles: list[tuple[int, int]]

    def forward(self, kernel: Callable[..., None]) -> None:
        """Fill `picture`."""
        lists = self.start, self.entries, self.record, self.feature, self.box, self.columns
        run_ranges(kernel, self.tiles, *lists, self.picture, self.stride, self.plane)

    def backward(self, kernel: Callable[..., None]) -> None:
        """Add to `slots`."""
        lists = self.start, self.entries, self.record, self.feature, self.box, self.columns
        run_ranges(kernel, self.tiles, *lists, self.picture, self.gradient, self.stride, self.plane, self.slots, numbered=True)


def torus(count: int, seed: int) -> list[np.ndarray]:
    """Disks all over a torus, 1 to 1.5 times as large as their spacing, opacity 0.6 to 0.99: the arguments of `project_range`."""
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
    parts = centre + MINOR * normal, quaternion, scale, np.log(opacity / (1 - opacity)), sh, rng.random((EXTRAS, count))
    return [np.ascontiguousarray(p, np.float32).reshape(-1) for p in parts]


def project(count: int, size: int, seed: int = 0) -> Splats:
    """The torus seen from 35 degrees above in a picture of size x size, with a random upstream gradient."""
    back = np.array([0.0, -math.cos(math.radians(35)), math.sin(math.radians(35))])
    pose = np.eye(4)
    pose[:3] = np.stack([[1, 0, 0], np.cross(back, [1, 0, 0]), back, 4 * back], -1)
    camera = Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, pose)
    record, feature = np.empty((count, RECORD), np.float32), np.empty((count, 6 + EXTRAS), np.float32)
    box, depth = np.empty((count, 4), np.int32), np.empty(count, np.float32)
    camera_array = camera_numbers(camera, NEAR)
    project_range(0, -(-count // 8), *torus(count, seed), 16, camera_array, count, record, feature, box, depth)
    columns = -(-size // TILE)
    start, entries = bin_tiles(depth_order(depth, box), box, columns, columns)
    stride, plane = columns * TILE, (columns * TILE) ** 2
    tiles = balanced_ranges(np.diff(start) + 1, thread_count())
    picture = np.empty((9 + EXTRAS) * plane, np.float32)
    gradient = np.random.default_rng(seed).normal(size=(8 + EXTRAS) * plane).astype(np.float32)
    slots = np.zeros((len(tiles), count, GEOMETRY + 6 + EXTRAS), np.float32)
    return Splats(start, entries, record, feature, box, columns, picture, gradient, stride, plane, slots, tiles)


def disagreement(splats: Splats) -> dict[str, float]:
    """How far both versions are apart: largest difference of a picture value, relative L2 of all gradients.

    Also warms the kernels up. Pixels exactly on a threshold may fall to either side of it.
    """
    pictures, gradients = [], []
    for forward, backward in KERNELS.values():
        splats.slots[:] = 0
        splats.forward(forward)
        splats.backward(backward)
        pictures.append(splats.picture.copy())
        gradients.append(splats.slots.sum(0, dtype=np.float64))
    relative = np.linalg.norm(gradients[0] - gradients[1]) / np.linalg.norm(gradients[1])
    return {"picture": float(np.abs(pictures[0] - pictures[1]).max()), "gradient": float(relative)}


def measure(splats: Splats, repetitions: int) -> dict[str, dict[str, float]]:
    """Median milliseconds of each kernel; the versions take turns, so that what else the machine does hits both alike."""
    times: dict[str, dict[str, list[float]]] = {name: {"forward": [], "backward": []} for name in KERNELS}
    for _ in range(repetitions):
        for name, (forward, backward) in KERNELS.items():
            splats.slots[:] = 0
            began = time.perf_counter()
            splats.forward(forward)
            middle = time.perf_counter()
            splats.backward(backward)
            times[name]["forward"].append(1e3 * (middle - began))
            times[name]["backward"].append(1e3 * (time.perf_counter() - middle))
    return {name: {part: statistics.median(values) for part, values in parts.items()} for name, parts in times.items()}


def benchmark(count: int, size: int, repetitions: int) -> dict[str, Any]:
    """One scene's figures."""
    splats = project(count, size)
    apart = disagreement(splats)
    medians = measure(splats, repetitions)
    ratio = sum(medians["vector"].values()) / sum(medians["plain"].values())
    return {"disks": count, "size": size, "threads": thread_count(), "difference": apart, "milliseconds": medians, "ratio": ratio}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--disks", type=int, nargs="+", default=[20_000, 100_000])
    parser.add_argument("--size", type=int, default=256, help="pixels along a side")
    parser.add_argument("--repetitions", type=int, default=9)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    results = []
    print(f"{'disks':>8} {'threads':>7} {'kernel':>7} {'forward ms':>11} {'backward ms':>11} {'ratio':>6}   difference: picture, gradient")
    for count in options.disks:
        result = benchmark(count, options.size, options.repetitions)
        results.append(result)
        for name, parts in result["milliseconds"].items():
            tail = f"{result['ratio']:6.3f}   {result['difference']['picture']:.1e}, {result['difference']['gradient']:.1e}"
            line = f"{count:8d} {result['threads']:7d} {name:>7} {parts['forward']:11.2f} {parts['backward']:11.2f} "
            print(line + (tail if name == "vector" else ""))
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
