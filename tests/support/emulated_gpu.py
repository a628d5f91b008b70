# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole job and relighting on an emulated GPU: tensors that claim to be elsewhere, and compute on the CPU behind that.

Whoever takes one for numpy, or mixes it with one of the CPU, gets an error, as on a real GPU. Kernels are those for GPUs, on warp's CPU
device.
"""

import os
import sys
from pathlib import Path
from typing import Any

import irgspp.core  # noqa: F401  (before torch: it settles how torch's threads wait)
import torch
import warp as wp
from irgspp.core import pipeline
from irgspp.core.kernels.warp import bilateral, light, lobes, mesh, photometric, rasterize, runtime
from irgspp.core.kernels.warp import trace as tracing
from irgspp.core.machine import devices
from irgspp.core.relight.backends import open_relighter
from irgspp.core.relight.prepared_light import prepare
from irgspp.core.relight.relighter import RelightSettings
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.shading.procedural_lights import sky_light
from torch.utils import _pytree, backend_registration
from torch.utils._python_dispatch import TorchDispatchMode

NAME = "emulated"
backend_registration._setup_privateuseone_for_python_backend(NAME)
GPU = torch.device(NAME, 0)
# Operations for which torch brings a tensor from the CPU to the GPU by itself.
MIXED = ("aten::index", "aten::_index_put_impl_", "aten::index_put", "aten::index_put_", "aten::copy_", "aten::_to_copy")


class Elsewhere(torch.Tensor):
    """A tensor on the emulated GPU; `raw` holds its values."""

    raw: torch.Tensor

    @staticmethod
    def __new__(cls, raw: torch.Tensor) -> "Elsewhere":
        layout = {"strides": raw.stride(), "storage_offset": raw.storage_offset(), "dtype": raw.dtype, "device": GPU}
        made = torch.Tensor._make_wrapper_subclass(cls, raw.shape, **layout, requires_grad=raw.requires_grad)
        made.raw = raw
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return computed(func, args, kwargs or {})


def computed(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """An operation with anything of the emulated GPU in it."""
    flat, shape = _pytree.tree_flatten((args, kwargs))
    ours = {id(t.raw): t for t in flat if isinstance(t, Elsewhere)}
    name, device = func._schema.name, kwargs.get("device")
    for t in flat:
        if isinstance(t, torch.Tensor) and not isinstance(t, Elsewhere) and ours and t.ndim and name not in MIXED:
            raise RuntimeError(f"{name}: tensors on {NAME} and on {t.device}")
    plain = [t.raw if isinstance(t, Elsewhere) else torch.device("cpu") if t == GPU else t for t in flat]
    args, kwargs = _pytree.tree_unflatten(plain, shape)
    out = func(*args, **kwargs)
    if name == "aten::_local_scalar_dense" or (device is not None and torch.device(device).type == "cpu"):
        return out
    if name == "aten::_to_copy" and device is None and not ours:
        return out
    return _pytree.tree_map_only(torch.Tensor, lambda t: ours.get(id(t)) if id(t) in ours else Elsewhere(t), out)


class Emulation(TorchDispatchMode):
    """Makes what is asked for on the emulated GPU."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        flat = _pytree.tree_leaves((args, kwargs))
        asked = kwargs.get("device")
        if (asked is not None and torch.device(asked).type == NAME) or any(isinstance(t, Elsewhere) for t in flat):
            return computed(func, args, kwargs)
        return func(*args, **kwargs)


def raw_of(value: Any) -> Any:
    return value.raw if isinstance(value, Elsewhere) else value


def emulate() -> None:
    """Let kernels work on what lies behind the tensors, and nothing else."""
    start, wrap = runtime.launch, wp.from_torch

    def launch(kernel: Any, dim: Any, *inputs: Any) -> None:
        for value in inputs:
            assert not isinstance(value, torch.Tensor) or isinstance(value, Elsewhere), f"{kernel.key}: a tensor on {value.device}"
        start(kernel, dim, *(raw_of(value.detach()) if isinstance(value, torch.Tensor) else value for value in inputs))

    for module in (bilateral, light, lobes, mesh, photometric, rasterize, tracing):
        module.launch = launch
    wp.from_torch = lambda tensor, *rest, **named: wrap(raw_of(tensor), *rest, **named)
    tracing._identity = lambda tensor: (raw_of(tensor.detach()).data_ptr(), tensor._version, tensor.shape)
    make = torch.tensor  # reads its values past all modes
    torch.tensor = lambda values, dtype=None, device="cpu": make(values, dtype=dtype).to(device)
    torch.Tensor.new_tensor = lambda like, values: make(values, dtype=like.dtype).to(like.device)
    chosen = devices.Chosen(GPU, "emulated", True, 80 << 30)
    pipeline.write_blend = lambda *_: None  # knows no GPU, and takes its time
    pipeline.choose = devices.choose = lambda name: chosen


def check_itself() -> None:
    """It must tell what a real GPU would not do."""
    there = torch.zeros(3, device=GPU)
    for wrong in (lambda: there + torch.zeros(3), there.numpy, lambda: torch.cat([there, torch.zeros(3)])):
        try:
            wrong()
        except (RuntimeError, TypeError):
            continue
        raise AssertionError("the emulated GPU lets everything pass")
    assert there.cpu().numpy().sum() == 0 and (there + 1).device == GPU


def main(dataset: Path, run: Path, changes: list[str]) -> None:
    """Reconstruct, and relight in every way."""
    emulate()
    with Emulation():
        check_itself()
        pipeline.reconstruct(dataset, run, with_overrides(preset("balanced"), changes), overwrite=True)
        found = Reconstruction.load(run).to(GPU)
        camera, sky = load_run_cameras(run / "cameras.json")[0].camera, prepare(sky_light(16, 32), GPU)
        ways = [("gaussian", {"samples": 8}), ("mesh", {"samples": 16, "error": 0.02}), ("mesh", {"samples": 8, "denoise": "off"})]
        for backend, how in ways:
            relighter = open_relighter(run, found, backend, RelightSettings(**how))
            assert relighter.relit(relighter.surface(camera), sky.turned(30.0)).isfinite().all()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
    sys.stdout.flush()
    os._exit(0)  # the emulated GPU's end is not provided for
