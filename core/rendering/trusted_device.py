# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the device by a self-test: a GPU is taken unasked only where its kernels agree with the float64 references."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import torch

from ..errors import IrgsppError
from ..kernels.photometric import photometric_loss
from ..kernels.rasterize import rasterize
from ..kernels.reference.photometric import photometric_reference
from ..kernels.reference.rasterize import rasterize_reference
from ..kernels.reference.trace import trace_reference
from ..kernels.trace import build_tree, trace
from ..machine.cuda import translate_gpu_errors
from ..machine.devices import ChosenDevice, choose_device
from ..scene.camera import Camera, look_at

GAUSSIANS, RAYS = 60, 96
TOLERANCE = 1e-2  # relative difference (L2) of results and gradients: at thresholds float32 may decide otherwise for a few rays
CAMERA = Camera(24, 18, 30.0, 30.0, 12.0, 9.0, look_at((2.5, 1.5, 2.0)))
Results = dict[str, list[torch.Tensor]]


def trusted_device(name: str = "auto", say: Callable[[str], object] = lambda message: None) -> ChosenDevice:
    """Choose a device as `choose_device`; "auto" takes a GPU only if it passes the self-test.

    Args:
        name: "auto", "cpu", "cuda", or "warp-cpu".
        say: receives a message before the test, which takes longer where the GPU's kernels must be compiled first.

    Raises:
        InputError: if cuda is requested and can't be used.
    """
    chosen = choose_device(name)
    if name != "auto" or chosen.device.type != "cuda":
        return chosen
    say("tests the GPU against the CPU")
    fault = gpu_fault(chosen.device)
    return chosen if fault is None else ChosenDevice(torch.device("cpu"), f"the GPU failed its self-test: {fault}")


@cache
def gpu_fault(device: torch.device) -> str | None:
    """Compare the kernels of a device with the float64 references, once per process; return what differs, None where nothing does.

    Args:
        device: a GPU, or the CPU within `warp_on_cpu`.
    """
    try:
        with translate_gpu_errors():
            found = _results(device, torch.float32)
    except IrgsppError as error:
        return str(error)
    expected = _results(torch.device("cpu"), torch.float64)
    for kernel, values in expected.items():
        for value, other in zip(values, found[kernel], strict=True):
            difference = float((other.cpu().double() - value).norm() / value.norm())
            if not difference <= TOLERANCE:
                return f"results of {kernel} differ by {difference:.1%}"
    return None


def _results(device: torch.device, dtype: torch.dtype) -> Results:
    """Return results and gradients of each kernel for random Gaussians, rays and images: by kernels or, in float64, references."""
    exact, random = dtype == torch.float64, torch.Generator().manual_seed(0)
    shapes = [(3, GAUSSIANS), (4, GAUSSIANS), (2, GAUSSIANS), (GAUSSIANS,), (16, 3, GAUSSIANS), (5, GAUSSIANS)]
    values = [torch.randn(shape, generator=random) for shape in shapes]
    values = [values[0] * 0.5, values[1], values[2] * 0.4 - 1.6, values[3] + 1.0, values[4] * 0.3, values[5].sigmoid()]
    values = [value.to(device, dtype).requires_grad_() for value in values]
    origin, direction = (torch.randn(RAYS, 3, generator=random).to(device, dtype) for _ in range(2))
    rays = (origin * 0.6, torch.nn.functional.normalize(direction, dim=1))
    images = [torch.rand(3, 20, 30, generator=random).to(device, dtype) for _ in range(2)]
    loss = photometric_reference if exact else photometric_loss
    position, quaternion, log_scale, opacity, sh, extra = values
    geometry = (position, quaternion, log_scale, opacity)
    cloud = (*geometry, sh, extra)
    drawn = rasterize_reference(*cloud, CAMERA, 1.0) if exact else rasterize(*cloud, CAMERA, 1.0)[0]
    traced = trace_reference(*cloud, *rays) if exact else trace(*cloud, *rays, build_tree(*geometry))
    shown = images[0].requires_grad_()
    return {
        "the rasteriser": _with_gradients(drawn, values),
        "the ray tracer": _with_gradients(traced, values),
        "the photometric loss": _with_gradients(loss(shown, images[1]), [shown]),
    }


def _with_gradients(result: torch.Tensor, inputs: list[torch.Tensor]) -> list[torch.Tensor]:
    """Return a result and the gradients of its sum of squares by the inputs."""
    return [result.detach(), *torch.autograd.grad(result.square().sum(), inputs)]
