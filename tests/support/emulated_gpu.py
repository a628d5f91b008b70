# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruction and relighting on an emulated GPU: its tensors report another device but compute on the CPU.

Converting one to numpy, or mixing it with a tensor of the CPU, is an error, as on a real GPU. Kernels are those for GPUs, on warp's
CPU device.
"""

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import irgspp.core  # noqa: F401  (before torch: it sets how torch's threads wait)
import torch
import warp as wp
from irgspp.core import pipeline
from irgspp.core.kernels.warp import runtime, tree
from irgspp.core.machine import devices
from irgspp.core.relight.backends import open_relighter
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.shading.procedural_lights import sky_light
from irgspp.core.stages.first import trainer
from irgspp.core.stages.second.solver import solver_run
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode

NAME = "emulated"
backend_registration._setup_privateuseone_for_python_backend(NAME)
GPU = torch.device(NAME, 0)
START_STEPS = 6  # of the solver before two starts are compared, instead of 20: more repeat the same operations
# Operations for which torch itself moves a tensor from the CPU to the GPU.
MIXED = ("aten::index", "aten::_index_put_impl_", "aten::index_put", "aten::index_put_", "aten::copy_", "aten::_to_copy")


class EmulatedTensor(torch.Tensor):
    """Tensor on the emulated GPU; `raw` holds its values."""

    raw: torch.Tensor

    @staticmethod
    def __new__(cls, raw: torch.Tensor) -> "EmulatedTensor":
        layout = {"strides": raw.stride(), "storage_offset": raw.storage_offset(), "dtype": raw.dtype, "device": GPU}
        made = torch.Tensor._make_wrapper_subclass(cls, raw.shape, **layout, requires_grad=raw.requires_grad)
        made.raw = raw
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return computed(func, args, kwargs or {})


def tensors_in(values: Any, found: list[torch.Tensor]) -> list[torch.Tensor]:
    """Append the tensors in nested lists and tuples to a list, and return it; torch's own functions for trees take much longer."""
    for value in values:
        if isinstance(value, torch.Tensor):
            found.append(value)
        elif isinstance(value, (list, tuple)):
            tensors_in(value, found)
    return found


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Change each value in nested lists and tuples."""
    return type(value)([mapped(part, change) for part in value]) if type(value) in (list, tuple) else change(value)


def on_cpu(value: Any) -> Any:
    return value.raw if isinstance(value, EmulatedTensor) else torch.device("cpu") if value == GPU else value


def computed(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """Compute an operation that involves the emulated GPU."""
    given = tensors_in((*args, *kwargs.values()), [])
    ours = {id(t.raw): t for t in given if isinstance(t, EmulatedTensor)}
    name, device = func._schema.name, kwargs.get("device")
    for t in given:
        if not isinstance(t, EmulatedTensor) and ours and t.ndim and name not in MIXED:
            raise RuntimeError(f"{name}: tensors on {NAME} and on {t.device}")
    out = func(*mapped(args, on_cpu), **{key: mapped(value, on_cpu) for key, value in kwargs.items()})
    if name == "aten::_local_scalar_dense" or (device is not None and torch.device(device).type == "cpu"):
        return out
    if name == "aten::_to_copy" and device is None and not ours:
        return out

    def on_gpu(value: Any) -> Any:
        if not isinstance(value, torch.Tensor):
            return value
        return ours[id(value)] if id(value) in ours else EmulatedTensor(value)

    return mapped(out, on_gpu)


class Emulation(TorchDispatchMode):
    """Mode in which operations on the emulated GPU are computed."""

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        """Leave out the guard that torch's compiler, which nothing here uses, has around each operation."""
        return False

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        device = kwargs.get("device")
        given = tensors_in((*args, *kwargs.values()), [])
        if (device is not None and torch.device(device).type == NAME) or any(isinstance(t, EmulatedTensor) for t in given):
            return computed(func, args, kwargs)
        return func(*args, **kwargs)


def raw_of(value: Any) -> Any:
    return value.raw if isinstance(value, EmulatedTensor) else value


def raw_argument(value: Any) -> Any:
    if isinstance(value, runtime.Addresses):
        return runtime.Addresses([raw_of(tensor) for tensor in value.tensors])
    return raw_of(value.detach()) if isinstance(value, torch.Tensor) else value


def emulate() -> None:
    """Let kernels work on the values of emulated tensors, and reject tensors of the CPU."""
    start, wrap = runtime.launch, wp.from_torch

    def launch(kernel: Any, dim: Any, *inputs: Any) -> None:
        for value in inputs:
            tensors = value.tensors if isinstance(value, runtime.Addresses) else [value] if isinstance(value, torch.Tensor) else []
            assert all(isinstance(tensor, EmulatedTensor) for tensor in tensors), f"{kernel.key}: a tensor on {value.device}"
        start(kernel, dim, *map(raw_argument, inputs))

    for module in [module for name, module in sys.modules.items() if name.startswith("irgspp.core.kernels.warp.")]:
        if hasattr(module, "launch"):  # others import it from `runtime` when they are needed
            module.launch = launch
    wp.from_torch = lambda tensor, *rest, **named: wrap(raw_of(tensor), *rest, **named)
    tree._identity = lambda tensor: (raw_of(tensor.detach()).data_ptr(), tensor._version, tensor.shape)
    make = torch.tensor  # it reads its values without the dispatch modes
    torch.tensor = lambda values, dtype=None, device="cpu": make(values, dtype=dtype).to(device)
    torch.Tensor.new_tensor = lambda like, values: make(values, dtype=like.dtype).to(like.device)
    chosen = devices.ChosenDevice(GPU, "emulated", True, 80 << 30)
    pipeline.write_blend = lambda *_: None  # slow, and independent of the GPU
    solver_run.START_STEPS = START_STEPS
    trainer.CHECKPOINT_SECONDS = math.inf  # torch can't save the emulated tensors, and a busy machine takes longer than this
    pipeline.trusted_device = lambda name, say: chosen
    devices.choose_device = lambda name: chosen


def check_itself() -> None:
    """Check that operations that fail on a real GPU also fail here."""
    on_gpu = torch.zeros(3, device=GPU)
    for wrong in (lambda: on_gpu + torch.zeros(3), on_gpu.numpy, lambda: torch.cat([on_gpu, torch.zeros(3)])):
        try:
            wrong()
        except (RuntimeError, TypeError):
            continue
        raise AssertionError("the emulated GPU accepts an operation that a real one does not")
    assert on_gpu.cpu().numpy().sum() == 0 and (on_gpu + 1).device == GPU


def main(dataset: Path, run: Path, changes: list[str]) -> None:
    """Reconstruct a dataset and relight the result with all backends."""
    emulate()
    with Emulation():
        check_itself()
        pipeline.reconstruct(dataset, run, with_overrides(preset("balanced"), changes), overwrite=True)
        found = Reconstruction.load(run).to(GPU)
        camera, sky = load_run_cameras(run / "cameras.json")[0].camera, prepare_light(sky_light(16, 32), GPU)
        cases = [("gaussian", {"samples": 8}), ("mesh", {"samples": 16, "error": 0.02}), ("mesh", {"samples": 8, "denoise": "off"})]
        for backend, settings in cases:
            relighter = open_relighter(run, found, backend, RelightSettings(**settings))
            assert relighter.relit(relighter.surface(camera), sky.turned(30.0)).isfinite().all()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
    sys.stdout.flush()
    os._exit(0)  # torch does not support the normal end of a process with this device
