# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of few surfels for tests of the joint optimisation: a bowl of 20 surfels that shadow and light each other, and its float64 twin."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import torch
from irgspp.core.kernels.reference.photometric import photometric_reference
from irgspp.core.kernels.reference.rasterize import rasterize_reference
from irgspp.core.kernels.reference.trace import trace_reference
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.gaussians import Gaussians, surfels
from irgspp.core.stages.common.training_view import TrainingView
from irgspp.core.stages.second.joint.model import Kernels

COUNT, SIZE = 20, 16


def bowl(seed: int = 0) -> Gaussians:
    """Return surfels on the inside of a bowl that opens towards +Z, each turned, scaled and coloured at random."""
    g = torch.Generator().manual_seed(seed)
    z = -1 + 0.9 * (np.arange(COUNT) + 0.5) / COUNT
    angle, r = np.arange(COUNT) * 2.39996, np.sqrt(1 - z**2)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)
    made = surfels(points, -points, np.full((COUNT, 3), 0.4), np.full(COUNT, 0.33), 0.8)
    noise = {"position": 0.05, "quaternion": 0.1, "log_scale": 0.2, "opacity": 0.4, "sh": 0.1, "material": 0.5}
    tensors = {name: value + noise[name] * torch.randn(value.shape, generator=g) for name, value in made.tensors().items()}
    tensors["material"][4] = tensors["material"][4] + 3.0  # some metal
    return Gaussians(**tensors)


def log_light(seed: int = 1) -> torch.Tensor:
    """Return the log radiance (8, 16, 3) of a random light."""
    return 0.5 * torch.randn(8, 16, 3, generator=torch.Generator().manual_seed(seed))


def camera() -> Camera:
    """Return a camera that looks into the bowl."""
    return Camera(SIZE, SIZE, 1.2 * SIZE, 1.2 * SIZE, SIZE / 2, SIZE / 2, look_at((0.9, -0.5, 2.2), (0.0, 0.0, -0.5)))


def to_double(value):
    """Return a dataclass of tensors, or a tensor, in float64."""
    if isinstance(value, torch.Tensor):
        return value.double() if value.is_floating_point() else value
    return replace(value, **{f.name: to_double(v) for f in fields(value) if isinstance(v := getattr(value, f.name), torch.Tensor)})


def _rasterize(g: Gaussians, extra: torch.Tensor, view: Camera, radius: float, subpixels: int) -> torch.Tensor:
    finer = view.resized(view.width * subpixels, view.height * subpixels)
    image = rasterize_reference(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, finer, radius)
    return torch.nn.functional.avg_pool2d(image[None], subpixels)[0]


def _trace(g: Gaussians, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    extra = g.position.new_zeros(0, g.count)
    return trace_reference(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, origin, direction)


REFERENCE = Kernels(_rasterize, _trace, photometric_reference)


def photograph(view: TrainingView, image: torch.Tensor) -> TrainingView:
    """Return a view with another image (3, H, W), random so that no difference from a rendering is near 0."""
    return replace(view, image=image, saturated=torch.zeros_like(image, dtype=torch.bool))


def random_image(seed: int = 2) -> torch.Tensor:
    """Return an image (3, SIZE, SIZE) of values in 0..1."""
    return torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(seed)) * 0.9


def disc() -> np.ndarray:
    """Return a mask (SIZE, SIZE) float32 with a soft edge."""
    x = np.arange(SIZE) + 0.5 - SIZE / 2
    return np.clip(SIZE * 0.45 - np.hypot(x, x[:, None]) + 0.5, 0, 1).astype(np.float32)
