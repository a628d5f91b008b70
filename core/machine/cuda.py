# SPDX-License-Identifier: GPL-3.0-or-later
"""What there is of CUDA, whether it will do, and what its errors mean for a job."""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from ..errors import IrgsppError

DRIVER = (13, 0)  # of CUDA, that the driver must know: what warp's wheel is built for
DRIVER_NAME = "580"
CAPABILITY = (7, 5)  # Turing: GeForce RTX 20, GTX 16, Quadro RTX, T4


@dataclass(frozen=True)
class Findings:
    """What was found.

    Attributes:
        driver: version of CUDA that the driver knows, None without one. torch_cuda: that of torch, None where it is built for the CPU.
        torch_sees: torch finds a GPU. capability: of the first one. free: bytes of its memory. warp: warp is installed.
    """

    driver: tuple[int, int] | None
    torch_cuda: str | None
    torch_sees: bool
    warp: bool
    capability: tuple[int, int] | None = None
    free: int = 0


def probe() -> Findings:
    """Look for a GPU. Nothing is started on it."""
    import torch

    sees = torch.cuda.is_available()
    capability = torch.cuda.get_device_capability(0) if sees else None
    free = torch.cuda.mem_get_info(0)[0] if sees else 0
    return Findings(_driver(), torch.version.cuda, sees, importlib.util.find_spec("warp") is not None, capability, free)


def _driver() -> tuple[int, int] | None:
    """Version of CUDA that the driver knows."""
    try:
        library = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None
    version = ctypes.c_int(0)
    if library.cuDriverGetVersion(ctypes.byref(version)):
        return None
    return version.value // 1000, version.value % 1000 // 10


def obstacle(found: Findings) -> tuple[str, str] | None:
    """Why CUDA can't be used and what to do about it, None where it can."""
    if found.driver is None:
        return "there is no NVIDIA driver", "use --device auto or cpu"
    if found.driver < DRIVER:
        knows = ".".join(map(str, found.driver))
        return (
            f"the NVIDIA driver is too old (it knows CUDA {knows})",
            f"install driver {DRIVER_NAME} or newer (CUDA {DRIVER[0]}.{DRIVER[1]})",
        )
    if found.torch_cuda is None:
        return "torch is installed for the CPU alone", "install a torch built for CUDA"
    if not found.torch_sees or found.capability is None:
        return "torch finds no GPU", "look at what nvidia-smi says"
    if found.capability < CAPABILITY:
        has = ".".join(map(str, found.capability))
        return f"the GPU is too old (compute capability {has})", f"one of {CAPABILITY[0]}.{CAPABILITY[1]} (Turing, 2018) or newer is needed"
    if not found.warp:
        return "warp-lang is not installed", "install the extra cuda: pip install irgspp[cuda]"
    return None


class DeviceLost(IrgsppError):
    """The GPU failed, or went away."""


OUT_OF_MEMORY = ("CUDA out of memory", "Failed to allocate", "out of memory on device")
SIGNS = ("CUDA error", "CUDA driver error", "Warp CUDA error", "cudaError", "an illegal memory access", *OUT_OF_MEMORY)


@contextmanager
def faults(resumable: bool = False) -> Iterator[None]:
    """Tell the GPU's errors in one line: raises IrgsppError where its memory ran out, DeviceLost where it failed.

    resumable: what was done before is kept in checkpoints.
    """
    import torch

    kept = "; what was done is kept: go on with --resume" if resumable else ""
    try:
        yield
    except RuntimeError as error:  # torch's AcceleratorError and warp's errors among them
        ours = (torch.OutOfMemoryError, getattr(torch, "AcceleratorError", torch.OutOfMemoryError))
        if not isinstance(error, ours) and not any(sign in str(error) for sign in SIGNS):
            raise
        if isinstance(error, torch.OutOfMemoryError) or any(sign in str(error) for sign in OUT_OF_MEMORY):
            raise IrgsppError(f"the GPU's memory ran out{kept}, with fewer Gaussians or smaller images (docs/gpu.md says how)") from error
        said = str(error).strip().splitlines()[0]
        raise DeviceLost(f"the GPU failed ({said}){kept}") from error
