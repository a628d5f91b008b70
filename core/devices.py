# SPDX-License-Identifier: GPL-3.0-or-later
"""What this machine offers to compute on."""

from __future__ import annotations

import os
import platform
import sys
from typing import Any

from .errors import InputError, IrgsppError
from .version import VERSION, problems

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

    from .kernels.pool import thread_count

    features = llvm.get_host_cpu_features()
    notes = ["this version computes on the CPU alone"] if torch.cuda.is_available() else []
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


def check_device(name: str) -> None:
    """Raise InputError where the device of that name can't be used; "auto" and "cpu" always can."""
    if name == "cuda":
        raise InputError("--device cuda", "this version has kernels for the CPU alone", "use --device auto or cpu")


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
