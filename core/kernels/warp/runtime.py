# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp set up for the engine: its cache, views of torch's tensors, launches on torch's stream, and sums over the threads of a warp."""

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
import warp as wp

from ...machine.cache_folder import private_folder


def _cache_folder() -> Path:
    """Return the folder of Warp's cache, named by Warp's version alone: Warp detects changed sources itself."""
    digest = hashlib.sha256(wp.config.version.encode()).hexdigest()[:12]
    return private_folder(f"warp-{digest}")


wp.config.quiet = True
wp.config.log_level = wp.LOG_ERROR
wp.config.kernel_cache_dir = str(_cache_folder())
wp.config.enable_backward = False  # adjoints are hand-written: Warp's own are wrong for a loop that updates the transmittance
wp.config.max_unroll = 32  # unrolled loops keep a splat's channels in registers
wp.init()

LANES = 32  # threads of a warp


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step /= 2)
        x += __shfl_xor_sync(0xffffffffu, x, step);
#endif
    return x;
""")
def lane_sum(x: float) -> float:
    """Return the sum of x over the threads of a warp, all of which must call it; x itself on a CPU, where each thread is alone."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __any_sync(0xffffffffu, x) ? 1 : 0;
#else
    return x;
#endif
""")
def any_lane(x: int) -> int:
    """Return 1 where x is not 0 for any thread of the warp, all of which must call it."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return (threadIdx.x & 31) == 0 ? 1 : 0;
#else
    return 1;
#endif
""")
def leads() -> int:
    """Return 1 for the first thread of a warp."""
    ...


@cache
def _parameters(kernel: Any) -> list[Any]:
    """Return the types of the parameters of a kernel."""
    return [argument.type for argument in kernel.adj.args]


def _argument(value: Any, parameter_type: Any) -> Any:
    """Return a tensor as the array that a kernel expects, without a copy; any other value unchanged."""
    if not isinstance(value, torch.Tensor):
        return value
    width, flat = getattr(parameter_type.dtype, "_length_", 1), value.detach()
    if parameter_type.ndim == 1:
        flat = flat.view(-1, width) if width > 1 else flat.view(-1)
    if value.is_cuda or flat.numel():
        return wp.from_torch(flat, parameter_type.dtype, requires_grad=False, return_ctype=True)
    return wp.empty(0 if parameter_type.ndim == 1 else tuple(flat.shape), dtype=parameter_type.dtype, device="cpu")


def launch(kernel: Any, dim: int | Sequence[int], *inputs: Any) -> None:
    """Launch a kernel on the device of its tensors, on torch's current stream.

    Args:
        kernel: Warp kernel.
        dim: number of threads per dimension.
        *inputs: arguments of the kernel. Tensors must be contiguous; vectors are their last dimension, such as (N, 3) for vec3.
    """
    device = next(value.device for value in inputs if isinstance(value, torch.Tensor))
    arguments = [_argument(value, expected) for value, expected in zip(inputs, _parameters(kernel), strict=True)]
    if device.type == "cuda":
        wp.launch(kernel, dim, arguments, stream=wp.stream_from_torch(torch.cuda.current_stream(device)), record_tape=False)
    else:
        wp.launch(kernel, dim, arguments, device="cpu", record_tape=False)


@contextlib.contextmanager
def on_stream(device: torch.device) -> Iterator[None]:
    """Within the block, run Warp's other work on the device (such as building trees) on torch's current stream as well."""
    if device.type != "cuda":
        yield
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)), sync_enter=False):
        yield
