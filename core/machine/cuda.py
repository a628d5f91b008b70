# SPDX-License-Identifier: GPL-3.0-or-later
"""CUDA on this machine: detection of driver, GPU and libraries, the reason why it can't be used, and its errors in plain words."""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from ..errors import IrgsppError

DRIVER = (13, 0)  # oldest CUDA version that the driver must support: the one that warp's wheel is built for
DRIVER_NAME = "580"
CAPABILITY = (7, 5)  # Turing: GeForce RTX 20, GTX 16, Quadro RTX, T4


@dataclass(frozen=True)
class CudaInfo:
    """CUDA support found on this machine.

    Attributes:
        driver: newest CUDA version that the driver supports; None without a driver.
        torch_cuda: CUDA version that torch is built for; None for a torch built for the CPU.
        torch_sees: torch finds a GPU.
        warp: warp is installed.
        capability: compute capability of the first GPU.
        free: free bytes of the first GPU's memory.
    """

    driver: tuple[int, int] | None
    torch_cuda: str | None
    torch_sees: bool
    warp: bool
    capability: tuple[int, int] | None = None
    free: int = 0


def probe_cuda() -> CudaInfo:
    """Detect driver, GPU and libraries, without starting any work on the GPU."""
    import torch

    sees = torch.cuda.is_available()
    capability = torch.cuda.get_device_capability(0) if sees else None
    free = torch.cuda.mem_get_info(0)[0] if sees else 0
    return CudaInfo(_driver(), torch.version.cuda, sees, importlib.util.find_spec("warp") is not None, capability, free)


def _driver() -> tuple[int, int] | None:
    """Return the newest CUDA version that the driver supports; None without a driver."""
    try:
        library = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None
    version = ctypes.c_int(0)
    if library.cuDriverGetVersion(ctypes.byref(version)):
        return None
    return version.value // 1000, version.value % 1000 // 10


def cuda_obstacle(found: CudaInfo) -> tuple[str, str] | None:
    """Return why CUDA can't be used and what to do about it; None where it can be used."""
    if found.driver is None:
        return "there is no NVIDIA driver", "use --device auto or cpu"
    if found.driver < DRIVER:
        newest = ".".join(map(str, found.driver))
        return (
            f"the NVIDIA driver is too old (it supports CUDA {newest})",
            f"install driver {DRIVER_NAME} or newer (CUDA {DRIVER[0]}.{DRIVER[1]})",
        )
    if found.torch_cuda is None:
        return "the installed torch is built for the CPU alone", "install a torch built for CUDA"
    if not found.torch_sees or found.capability is None:
        return "torch finds no GPU", "run nvidia-smi to see whether the driver finds it"
    if found.capability < CAPABILITY:
        actual = ".".join(map(str, found.capability))
        needed = f"use a GPU of compute capability {CAPABILITY[0]}.{CAPABILITY[1]} (Turing, 2018) or newer"
        return f"the GPU is too old (compute capability {actual})", needed
    if not found.warp:
        return "warp-lang is not installed", "install the extra cuda: pip install irgspp[cuda]"
    return None


class DeviceLost(IrgsppError):
    """Failure or disconnection of the GPU."""


OUT_OF_MEMORY = ("CUDA out of memory", "Failed to allocate", "out of memory on device")
GPU_ERRORS = ("CUDA error", "CUDA driver error", "Warp CUDA error", "cudaError", "an illegal memory access", *OUT_OF_MEMORY)


@contextmanager
def translate_gpu_errors(resumable: bool = False) -> Iterator[None]:
    """Translate the GPU's errors within the block into one line each; other errors pass unchanged.

    Args:
        resumable: checkpoints hold the work done so far, and the message says that --resume continues from them.

    Raises:
        IrgsppError: if the GPU's memory ran out.
        DeviceLost: if the GPU failed.
    """
    import torch

    advice = "; the work done so far is saved: continue with --resume" if resumable else ""
    try:
        yield
    except RuntimeError as error:  # torch's AcceleratorError and warp's errors among them
        gpu_errors = (torch.OutOfMemoryError, getattr(torch, "AcceleratorError", torch.OutOfMemoryError))
        if not isinstance(error, gpu_errors) and not any(text in str(error) for text in GPU_ERRORS):
            raise
        if isinstance(error, torch.OutOfMemoryError) or any(text in str(error) for text in OUT_OF_MEMORY):
            raise IrgsppError(f"the GPU's memory ran out{advice}, with fewer Gaussians or smaller images (see docs/gpu.md)") from error
        reason = str(error).strip().splitlines()[0]
        raise DeviceLost(f"the GPU failed ({reason}){advice}") from error
