# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp set up for the engine: its cache, views of torch's tensors, launches on torch's stream, and sums over the threads of a warp."""

import contextlib
import ctypes
import hashlib
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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


POINTERS = 16  # of which a kernel takes so many at once
Pointers = wp.types.vector(length=POINTERS, dtype=wp.uint64)


@dataclass(frozen=True)
class Addresses:
    """Up to POINTERS contiguous tensors that a kernel takes by their addresses, as one parameter of type Pointers.

    Attributes:
        tensors: float32, on one device; the kernel must know their sizes. At least one.
    """

    tensors: Sequence[torch.Tensor]

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self.tensors[0].device

    def vector(self) -> Any:
        """Return the addresses, 0 for those that are missing."""
        for tensor in self.tensors:
            if tensor.dtype != torch.float32 or not tensor.is_contiguous() or tensor.device != self.device:
                raise ValueError(f"a kernel needs contiguous float32 tensors on one device, not {tuple(tensor.shape)} of {tensor.dtype}")
        return Pointers(*[tensor.data_ptr() for tensor in self.tensors], *[0] * (POINTERS - len(self.tensors)))


@dataclass(frozen=True)
class _Array:
    """An array among a kernel's parameters: class of its descriptor, dimensions, torch's dtype, and values and bytes per entry."""

    descriptor: Callable[..., Any]
    ndim: int
    dtype: torch.dtype
    width: int
    size: int

    def of(self, tensor: torch.Tensor) -> Any:
        """Return the descriptor of a tensor, without a copy."""
        whole = tensor.is_contiguous()
        if tensor.dtype != self.dtype or not (whole or (self.ndim > 1 and tensor[(0,) * self.ndim].is_contiguous())):
            raise ValueError(f"a kernel needs a contiguous tensor of {self.dtype}, not {tuple(tensor.shape)} of {tensor.dtype}")
        shape = (tensor.numel() // self.width,) if self.ndim == 1 else tensor.shape[: self.ndim]
        if not whole:
            steps = [stride * self.dtype.itemsize for stride in tensor.stride()[: self.ndim]]
            return self.descriptor(tensor.data_ptr(), 0, self.ndim, shape, steps)
        strides = [self.size] * self.ndim
        for i in range(self.ndim - 1, 0, -1):
            strides[i - 1] = strides[i] * shape[i]
        return self.descriptor(tensor.data_ptr(), 0, self.ndim, shape, strides)


@cache
def _parameters(kernel: Any) -> list[_Array | None]:
    """Return the arrays among the parameters of a kernel; None for the others."""
    return [_array(argument.type) if isinstance(argument.type, wp.array) else None for argument in kernel.adj.args]


def _array(parameter: Any) -> _Array:
    """Return what a tensor for a parameter must be."""
    scalar, width = getattr(parameter.dtype, "_wp_scalar_type_", parameter.dtype), math.prod(getattr(parameter.dtype, "_shape_", (1,)))
    dtype = wp.dtype_to_torch(scalar)
    return _Array(type(parameter.__ctype__()), parameter.ndim, dtype, width, width * dtype.itemsize)


def _argument(value: Any, array: _Array | None) -> Any:
    """Return tensors as a kernel takes them; any other value unchanged."""
    if isinstance(value, Addresses):
        return value.vector()
    return value if array is None or not isinstance(value, torch.Tensor) else array.of(value)


_commands: dict[tuple[Any, torch.device], Any] = {}  # launches to repeat with other arguments: much of a launch's time is its preparation
_lock = threading.Lock()  # a command holds the arguments of one launch


def launch(kernel: Any, dim: int | Sequence[int], *inputs: Any) -> None:
    """Launch a kernel on the device of its tensors, on torch's current stream.

    Args:
        kernel: Warp kernel.
        dim: number of threads per dimension.
        *inputs: arguments of the kernel, among them a tensor. Vectors are its last dimension, such as (N, 3) for vec3. Tensors must
            be contiguous; for an array of several dimensions its entries must.
    """
    size = (dim,) if isinstance(dim, int) else tuple(dim)
    if 0 in size:
        return
    device = next(value.device for value in inputs if isinstance(value, (torch.Tensor, Addresses)))
    arguments = [_argument(value, array) for value, array in zip(inputs, _parameters(kernel), strict=True)]
    with _lock:
        command = _commands.get((kernel, device))
        if command is None:
            command = wp.launch(kernel, size, arguments, device=str(device), record_cmd=True, record_tape=False)
            _commands[kernel, device] = command
        else:
            command.set_dim(size)
            for i, value in enumerate(arguments):
                if isinstance(value, (int, float, ctypes.Structure)):
                    command.set_param_at_index_from_ctype(i, value)
                else:
                    command.set_param_at_index(i, value)
        command.launch(None if device.type == "cpu" else _stream(torch.cuda.current_stream(device)))


@cache
def _stream(stream: torch.cuda.Stream) -> wp.Stream:
    """Return torch's stream as one of Warp's."""
    return wp.stream_from_torch(stream)


@contextlib.contextmanager
def on_stream(device: torch.device) -> Iterator[None]:
    """Within the block, run Warp's other work on the device (such as building trees) on torch's current stream as well."""
    if device.type != "cuda":
        yield
        return
    with wp.ScopedStream(_stream(torch.cuda.current_stream(device)), sync_enter=False):
        yield
