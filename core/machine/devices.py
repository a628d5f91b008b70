# SPDX-License-Identifier: GPL-3.0-or-later
"""Compute devices of this machine: listing them, and choosing the one that a job runs on."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import InputError, IrgsppError
from . import cuda
from .version import VERSION, missing_libraries

if TYPE_CHECKING:
    import torch

WARP_ON_CPU = "warp-cpu"  # for tests: the GPU's kernels on warp's CPU device, slowly
SIMD = ("avx512f", "avx2", "fma", "neon", "sve", "sse4.2")


def devices() -> dict[str, Any]:
    """List the devices that can be used, as plain values for JSON.

    Returns:
        {"irgspp": version, "python": version, "cpu": {name, threads, cores, simd}, "cuda": [{index, name, memory}], "notes": [lines]},
        with the memory in bytes.

    Raises:
        IrgsppError: if a library is missing or too old.
    """
    if missing := missing_libraries():
        raise IrgsppError(f"this Python ({sys.executable}) can't run the engine: {'; '.join(missing)}")
    import llvmlite.binding as llvm
    import torch

    from .thread_pool import thread_count

    features = llvm.get_host_cpu_features()
    obstacle = cuda.cuda_obstacle(cuda.probe_cuda())
    notes = ["cuda can be used"] if obstacle is None else [f"cuda can't be used: {'; '.join(obstacle)}"]
    return {
        "irgspp": VERSION,
        "python": platform.python_version(),
        "cpu": {
            "name": f"{platform.machine()} {llvm.get_host_cpu_name()}",
            "threads": thread_count(),
            "cores": os.cpu_count() or 1,
            "simd": [name for name in SIMD if features.get(name)],
        },
        "cuda": [_cuda(i) for i in range(torch.cuda.device_count())] if torch.cuda.is_available() else [],
        "notes": notes,
    }


@dataclass(frozen=True)
class ChosenDevice:
    """Device that a job computes on.

    Attributes:
        device: torch's device.
        why: reason for the choice, in words for the user.
        warp: warp's kernels are used, whatever the device.
        free: free bytes of the GPU's memory.
    """

    device: torch.device
    why: str
    warp: bool = False
    free: int = 0


def choose_device(name: str, probe: Callable[[], cuda.CudaInfo] = cuda.probe_cuda) -> ChosenDevice:
    """Choose the device that a job computes on.

    Args:
        name: "auto" (a GPU if one can be used, else the CPU), "cpu", "cuda", or "warp-cpu" (for tests).
        probe: detects CUDA.

    Raises:
        InputError: if cuda is requested and can't be used.
    """
    import torch

    if name == WARP_ON_CPU:
        return ChosenDevice(torch.device("cpu"), "requested, for a test", True)
    if name == "cpu":
        return ChosenDevice(torch.device("cpu"), "requested")
    found = probe()
    obstacle = cuda.cuda_obstacle(found)
    if obstacle is None:
        return ChosenDevice(torch.device("cuda", 0), "requested" if name == "cuda" else "a suitable GPU was found", True, found.free)
    if name == "cuda":
        raise InputError("--device cuda", *obstacle)
    return ChosenDevice(torch.device("cpu"), f"cuda can't be used: {obstacle[0]}")


@contextmanager
def computing_on(chosen: ChosenDevice, resumable: bool = False) -> Iterator[None]:
    """Use the chosen device's kernels within the block, and translate the GPU's errors into one line each.

    Args:
        chosen: the device.
        resumable: checkpoints hold the work done so far (see `cuda.translate_gpu_errors`).
    """
    from .backend import warp_on_cpu

    # Beside a GPU, tensors of the CPU stay with the CPU's kernels.
    with warp_on_cpu(chosen.warp and chosen.device.type == "cpu"), cuda.translate_gpu_errors(resumable):
        yield


def _cuda(index: int) -> dict[str, Any]:
    import torch

    properties = torch.cuda.get_device_properties(index)
    return {"index": index, "name": properties.name, "memory": properties.total_memory}


def describe(found: dict[str, Any]) -> str:
    """Format the result of `devices()` as text for the user."""
    cpu = found["cpu"]
    lines = [f"cpu     {cpu['name']}, {cpu['threads']} threads of {cpu['cores']} cores, {' '.join(cpu['simd']) or 'no known SIMD'}"]
    lines += [f"cuda:{d['index']}  {d['name']}, {d['memory'] / 2**30:.1f} GiB" for d in found["cuda"]]
    if not found["cuda"]:
        lines.append("cuda    none found")
    return "\n".join(lines + found["notes"])
