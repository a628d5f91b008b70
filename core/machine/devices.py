# SPDX-License-Identifier: GPL-3.0-or-later
"""What this machine offers to compute on."""

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
from .version import VERSION, problems

if TYPE_CHECKING:
    import torch

WARP_ON_CPU = "warp-cpu"  # for tests: the GPU's kernels on warp's CPU device, slowly
SIMD = ("avx512f", "avx2", "fma", "neon", "sve", "sse4.2")


def devices() -> dict[str, Any]:
    """What can be used, ready for JSON.

    {"irgspp": version, "python": version, "cpu": {name, threads, cores, simd}, "cuda": [{index, name, memory}], "notes": [lines]}

    Raises IrgsppError where a library is missing or too old.
    """
    if lacking := problems():
        raise IrgsppError(f"this Python ({sys.executable}) can't run the engine: {'; '.join(lacking)}")
    import llvmlite.binding as llvm
    import torch

    from .thread_pool import thread_count

    features = llvm.get_host_cpu_features()
    hindered = cuda.obstacle(cuda.probe())
    notes = ["cuda can be used"] if hindered is None else [f"cuda can't be used: {'; '.join(hindered)}"]
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
class Chosen:
    """What a job computes on: a device of torch's, and why it is this one."""

    device: torch.device
    why: str
    warp: bool = False  # the GPU's kernels work, whatever the device
    free: int = 0  # bytes of the GPU's memory


def choose(name: str, probe: Callable[[], cuda.Findings] = cuda.probe) -> Chosen:
    """The device of the name auto, cpu or cuda: auto is a GPU that will do, else the CPU.

    Raises InputError where cuda is asked for and can't be used.
    """
    import torch

    if name == WARP_ON_CPU:
        return Chosen(torch.device("cpu"), "asked for, for a test", True)
    if name == "cpu":
        return Chosen(torch.device("cpu"), "asked for")
    found = probe()
    hindered = cuda.obstacle(found)
    if hindered is None:
        return Chosen(torch.device("cuda", 0), "asked for" if name == "cuda" else "a GPU that will do", True, found.free)
    if name == "cuda":
        raise InputError("--device cuda", *hindered)
    return Chosen(torch.device("cpu"), f"cuda can't be used: {hindered[0]}")


def best() -> torch.device:
    """A GPU that will do, else the CPU."""
    return choose("auto").device


@contextmanager
def computing_on(chosen: Chosen, resumable: bool = False) -> Iterator[None]:
    """Within it, the chosen device's kernels do the work, and its errors are told in one line."""
    from .backend import warp_on_cpu

    with warp_on_cpu(chosen.warp), cuda.faults(resumable):
        yield


def _cuda(index: int) -> dict[str, Any]:
    import torch

    properties = torch.cuda.get_device_properties(index)
    return {"index": index, "name": properties.name, "memory": properties.total_memory}


def describe(found: dict[str, Any]) -> str:
    """`devices()` as text for a person."""
    cpu = found["cpu"]
    lines = [f"cpu     {cpu['name']}, {cpu['threads']} threads of {cpu['cores']} cores, {' '.join(cpu['simd']) or 'no SIMD known'}"]
    lines += [f"cuda:{d['index']}  {d['name']}, {d['memory'] / 2**30:.1f} GiB" for d in found["cuda"]]
    if not found["cuda"]:
        lines.append("cuda    none found")
    return "\n".join(lines + found["notes"])
