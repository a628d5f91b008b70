# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp set up for this engine: its cache, its views of torch's tensors, launches on torch's stream, what threads of a warp share."""

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
    """Like numba's, but by these sources alone: warp looks for changes itself."""
    digest = hashlib.sha256(wp.config.version.encode()).hexdigest()[:12]
    return private_folder(f"warp-{digest}")


wp.config.quiet = True
wp.config.log_level = wp.LOG_ERROR
wp.config.kernel_cache_dir = str(_cache_folder())
wp.config.enable_backward = False  # adjoints are written by hand: warp's own is wrong through a loop that changes the transmittance
wp.config.max_unroll = 32  # loops over a splat's channels, which then stay in registers
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
    """Sum over the threads of a warp, all of which must come here; x itself on a CPU, where a thread is alone."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __any_sync(0xffffffffu, x) ? 1 : 0;
#else
    return x;
#endif
""")
def any_lane(x: int) -> int:
    """1 where x is not 0 for any thread of the warp, all of which must come here."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return (threadIdx.x & 31) == 0 ? 1 : 0;
#else
    return 1;
#endif
""")
def leads() -> int:
    """1 for the first thread of a warp."""
    ...


@cache
def _parameters(kernel: Any) -> list[Any]:
    return [argument.type for argument in kernel.adj.args]


def _argument(value: Any, kind: Any) -> Any:
    """A tensor as the array that a kernel wants, without a copy; anything else as it is."""
    if not isinstance(value, torch.Tensor):
        return value
    width, flat = getattr(kind.dtype, "_length_", 1), value.detach()
    if kind.ndim == 1:
        flat = flat.view(-1, width) if width > 1 else flat.view(-1)
    if value.is_cuda or flat.numel():
        return wp.from_torch(flat, kind.dtype, requires_grad=False, return_ctype=True)
    return wp.empty(0 if kind.ndim == 1 else tuple(flat.shape), dtype=kind.dtype, device="cpu")


def launch(kernel: Any, dim: int | Sequence[int], *inputs: Any) -> None:
    """Start a kernel where its tensors are, on torch's current stream. Tensors must be contiguous; vectors are their last dimension."""
    device = next(value.device for value in inputs if isinstance(value, torch.Tensor))
    arguments = [_argument(value, kind) for value, kind in zip(inputs, _parameters(kernel), strict=True)]
    if device.type == "cuda":
        wp.launch(kernel, dim, arguments, stream=wp.stream_from_torch(torch.cuda.current_stream(device)), record_tape=False)
    else:
        wp.launch(kernel, dim, arguments, device="cpu", record_tape=False)


@contextlib.contextmanager
def on_stream(device: torch.device) -> Iterator[None]:
    """What warp does beside launches (it builds trees) also runs on torch's current stream."""
    if device.type != "cuda":
        yield
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)), sync_enter=False):
        yield
