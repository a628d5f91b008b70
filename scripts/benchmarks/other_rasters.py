# SPDX-License-Identifier: GPL-3.0-or-later
"""Forward pass of the rasteriser by other technologies, for comparison only: C++, warp on its CPU device, torch."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.kernels.constants import ALPHA_MAX, HORIZON_MIN, LOW_PASS, TILE, TRANSMITTANCE_MIN
from irgspp.core.kernels.reference.rasterize import rasterize_reference
from irgspp.core.machine.thread_pool import run_ranges

from .workloads import Splats, torus, viewer

SOURCE = Path(__file__).with_name("raster.cpp")
CONSTANTS = (LOW_PASS, ALPHA_MAX, TRANSMITTANCE_MIN, HORIZON_MIN)
Forward = Callable[[Splats], None]  # fills `image`


def compiler() -> str | None:
    """Return the path of a C++ compiler of this machine, $CXX or one of the usual names; None where there is none."""
    return next((found for name in (os.environ.get("CXX", ""), "g++", "clang++") if name and (found := shutil.which(name))), None)


def by_cpp(folder: Path) -> Forward:
    """Compile the C++ rasteriser with -O3 for this machine's CPU and return its forward pass.

    Args:
        folder: folder for the library.

    Raises:
        IrgsppError: where there is no compiler, or it fails.
    """
    command = compiler()
    if command is None:
        raise IrgsppError("there is no C++ compiler (neither $CXX nor g++ nor clang++)")
    folder.mkdir(parents=True, exist_ok=True)
    library = folder / "raster.so"
    done = subprocess.run(
        [command, "-O3", "-march=native", "-shared", "-fPIC", str(SOURCE), "-o", str(library)], capture_output=True, text=True
    )
    if done.returncode:
        raise IrgsppError(f"{command} failed: {done.stderr.strip().splitlines()[-1]}")
    function = ctypes.CDLL(str(library.resolve())).raster_range

    def kernel(begin: int, end: int, s: Splats) -> None:
        """Call the library for a range of tiles."""
        arrays = (s.start, s.entries, s.record, s.record.shape[1], s.feature, s.feature.shape[1], s.box, s.columns, s.image)
        words = [a.ctypes.data_as(ctypes.c_void_p) if isinstance(a, np.ndarray) else ctypes.c_int64(a) for a in arrays]
        numbers = (ctypes.c_int64(s.stride), ctypes.c_int64(s.plane), *map(ctypes.c_float, CONSTANTS))
        function(ctypes.c_int64(begin), ctypes.c_int64(end), *words, *numbers)

    def forward(splats: Splats) -> None:
        """Fill the image of the splats."""
        assert splats.start.dtype == np.int64 and splats.entries.dtype == np.int32
        run_ranges(kernel, splats.tiles, splats)

    return forward


def by_warp(features: int) -> Forward:
    """Return the forward pass by the package's GPU kernel on warp's CPU device, which has one thread.

    Args:
        features: feature channels of the splats.

    Raises:
        IrgsppError: where warp is not installed.
    """
    try:
        from irgspp.core.kernels.warp import raster, runtime
    except ImportError as error:
        raise IrgsppError("warp is not installed (extra cuda)") from error
    kernel, _ = raster.kernels(features)

    def forward(s: Splats) -> None:
        """Fill the image of the splats."""
        rows = s.plane // s.stride
        start, entries, record, feature, box, image = map(torch.from_numpy, (s.start, s.entries, s.record, s.feature, s.box, s.image))
        lists = (start.int(), torch.arange(len(entries)), entries, record, feature, box, s.columns, s.stride, rows)
        runtime.launch(kernel, s.plane, *lists, image)

    return forward


def by_torch(count: int, size: int, seed: int = 0) -> Callable[[], torch.Tensor]:
    """Return the forward pass by the float64 reference in torch, which evaluates every surfel at every pixel.

    Args:
        count: surfels of the torus.
        size: pixels along a side of the image.
        seed: seed of the torus.
    """
    parts = [torch.from_numpy(a) for a in torus(count, seed)]
    shapes = [(3,), (4,), (2,), (), (16, 3), (len(parts[5]) // count,)]
    parameters = [a.view(*shape, count).double() for a, shape in zip(parts, shapes, strict=True)]
    camera = viewer(size)
    return lambda: rasterize_reference(*parameters, camera, 1.4)


def cropped(splats: Splats, size: int) -> np.ndarray:
    """Return the filled image without padding and transmittance.

    Args:
        splats: projected scene.
        size: pixels along a side of the image.

    Returns:
        (channels, size, size).
    """
    planes = splats.image.reshape(-1, splats.columns * TILE, splats.columns * TILE)
    return planes[:-1, :size, :size]
