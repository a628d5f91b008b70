# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of both stages on a pretended GPU: a tensor left on the CPU, or a wait of the host for a value, is an error of torch.

Torch's fake tensors have a device and a shape but no values: reading a value is an error, and so is an operation on tensors of two
devices. Kernels are not launched; their arguments are checked.
"""

import dataclasses
import os
import sys
from pathlib import Path
from typing import Any

import irgspp.core  # noqa: F401  (before torch: it sets how torch's threads wait)
import numpy as np
import torch
from irgspp.core.kernels.warp import rasterize, runtime
from irgspp.core.machine import backend
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import FirstStageSettings, SecondStageSettings
from irgspp.core.shading import sampling, specular_albedo, split_sum
from irgspp.core.stages.common.finite_check import CHECK_EVERY
from irgspp.core.stages.first.initialization import surfels
from irgspp.core.stages.first.material_class import MATERIAL_CLASSES
from irgspp.core.stages.first.trainer import Trainer
from irgspp.core.stages.second.refinement.pixel_pool import pool_pixels
from irgspp.core.stages.second.refinement.refinement import Refinement
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils import backend_registration

NAME = "pretended"
backend_registration._setup_privateuseone_for_python_backend(NAME)
GPU = torch.device(NAME, 0)
launched: list[str] = []


def launch(kernel: Any, dim: Any, *inputs: Any) -> None:
    """Check the arguments of a kernel instead of launching it: all tensors are on the GPU and contiguous."""
    tensors = [t for value in inputs for t in (value.tensors if isinstance(value, runtime.Addresses) else [value])]
    for value in tensors:
        if isinstance(value, torch.Tensor):
            assert value.device.type == NAME, f"{kernel.key}: a tensor on {value.device}"
            assert value.is_contiguous(), f"{kernel.key}: a tensor that is not contiguous"
    assert len(inputs) == len(kernel.adj.args), f"{kernel.key}: {len(inputs)} arguments"
    launched.append(kernel.key)


def moved(value: Any, seen: dict[int, Any]) -> Any:
    """Return an object with all its tensors on the pretended GPU; random generators and values used by the host stay."""
    if id(value) in seen:
        return seen[id(value)]
    if isinstance(value, torch.Tensor):
        made = value.detach().to(GPU).requires_grad_(value.requires_grad)
        seen[id(value)] = made
        return made
    if isinstance(value, (list, tuple)):
        made = [moved(v, seen) for v in value]
        return made if isinstance(value, list) else type(value)(*made) if hasattr(value, "_fields") else tuple(made)
    if isinstance(value, dict):
        return {k: moved(v, seen) for k, v in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and type(value).__module__.startswith("irgspp"):
        seen[id(value)] = made = object.__new__(type(value))
        for name, inner in vars(value).items():
            object.__setattr__(made, name, moved(inner, seen))
        return made
    if type(value).__module__.startswith("irgspp") and hasattr(value, "__dict__") and not isinstance(value, type):
        seen[id(value)] = made = object.__new__(type(value))
        made.__dict__.update({name: moved(inner, seen) for name, inner in vars(value).items()})
        return made
    return value


def sphere(views: int = 9, size: int = 24, count: int = 300) -> tuple[Dataset, Reconstruction]:
    """Return a dataset of grey images, and a reconstruction with surfels on a sphere."""
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.399963
    r = np.sqrt(1 - z**2)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    splats = surfels(points, points, np.full((count, 3), 0.5), np.full(count, 1.3 * np.sqrt(4 * np.pi / count)), 0.95)
    bound, taken = Bound((0.0, 0.0, 0.0), 1.5), []
    for i in range(views):
        camera = Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at((4 * np.cos(i), 4 * np.sin(i), 1.0)))
        alpha = np.ones((size, size), np.float32)
        taken.append(View(f"{i}", camera, Path(f"{i}.png"), np.full((size, size, 3), 0.5, np.float32), alpha))
    data = Dataset(Path("sphere"), "transforms", taken, [], bound, np.eye(4), None)
    return data, Reconstruction(splats, torch.ones(8, 16, 3), bound, np.eye(4))


def main() -> None:
    """Run steps of both stages; an error ends the process."""
    data, start = sphere()
    with backend.warp_on_cpu():
        trainers = [
            Trainer(data, FirstStageSettings(iterations=100, gaussians=300, light_height=8), start.gaussians, material_class, 0, 0)
            for material_class in MATERIAL_CLASSES[:2]
        ]
        settings, refinements = SecondStageSettings(iterations=100, pixels=16, samples=16), []
        for glossy in (False, True):
            known = dataclasses.replace(start, has_split_sum=glossy)
            tracer = SecondaryTracer(known)
            pool = pool_pixels(data.train, tracer, 500, np.random.default_rng(0), 2)
            refinements.append(Refinement(known, pool, tracer, settings, 0))
    for module in [module for name, module in sys.modules.items() if name.startswith("irgspp.core.kernels.warp.")]:
        if hasattr(module, "launch"):
            module.launch = launch
    rasterize._on_its_way = lambda total: (0, None)
    room = rasterize.Room()
    room._entries = 4000
    rasterize.ROOMS = type("Rooms", (dict,), {"setdefault": lambda self, key, default: room})()
    runtime.launch = launch
    for table in (split_sum._operator, specular_albedo.brdf_table, sampling.point_set):
        table.cache_clear()  # computed on the CPU, of real tensors
    with FakeTensorMode(allow_non_fake_inputs=True):
        for trainer in trainers:
            on_gpu = moved(trainer, {})
            on_gpu.device, on_gpu._next_view = GPU, lambda: 0  # the host chooses the view, which needs values
            on_gpu.optimizer.others = {name: getattr(on_gpu, name) for name in on_gpu.optimizer.others}
            on_gpu.optimizer.adopt(on_gpu.optimizer.gaussians)
            on_gpu.done = on_gpu.optimizer._steps = CHECK_EVERY + 1  # the losses of these steps are not read
            for _ in range(3):
                on_gpu.step()
        for refinement in refinements:
            on_gpu = moved(refinement, {})
            on_gpu.tracer.device = GPU
            on_gpu.optimizer.others = {"light": on_gpu.light}
            on_gpu.optimizer.adopt(on_gpu.optimizer.gaussians)
            on_gpu.done = on_gpu.optimizer._steps = CHECK_EVERY + 1  # the losses of these steps are not read
            for _ in range(3):
                on_gpu.step()
    print(" ".join(sorted(set(launched))), flush=True)


if __name__ == "__main__":
    main()
    os._exit(0)  # torch does not support the normal end of a process with this device
