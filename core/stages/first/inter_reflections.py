# SPDX-License-Identifier: GPL-3.0-or-later
"""Inter-reflections of the first stage: what the mirrored rays of each view meet on the object itself."""

from __future__ import annotations

from dataclasses import replace

import torch

from ...kernels.rasterize import rasterize
from ...machine.lazy_sequence import LazySequence
from ...rendering.deferred import surface_pixels
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.dataset import Dataset, light_rotations
from ...scene.gaussians import Gaussians
from ...scene.reconstruction import Reconstruction
from ...settings.schema import FirstStageSettings
from ...shading.split_sum import reflect
from ..common.training_view import TrainingView
from ..common.training_view_cache import TrainingViewCache
from .material_class import MaterialClass

MEMORY = 1 << 30  # bytes of images that are kept


def traced_from(settings: FirstStageSettings, material_class: MaterialClass, dataset: Dataset) -> float:
    """Return the part of the schedule after which mirrored rays are traced, 1 for never.

    Args:
        settings: of the first stage.
        material_class: decides where the settings do not; without reflections nothing is traced.
        dataset: where the light turns with the photographs, one radiance cannot be what all of them mirror.
    """
    if not material_class.split_sum or light_rotations(dataset.train) is not None:
        return 1.0
    return material_class.inter_reflections if settings.inter_reflections is None else settings.inter_reflections


class InterReflections(LazySequence[torch.Tensor]):
    """Images of what mirrored rays meet, traced through a copy of the surfels when a view is first asked for.

    An image is (4, H, W): transmittance along the mirrored direction, and linear radiance of what blocks it.

    Args:
        copy: reconstruction with split-sum reflections, which must not change.
        views: training views.
    """

    def __init__(self, copy: Reconstruction, views: TrainingViewCache) -> None:
        super().__init__(len(views), MEMORY)
        self._copy, self._views, self._tracer = copy, views, SecondaryTracer(copy)

    def make(self, index: int) -> torch.Tensor:
        """Trace the mirrored rays of a view."""
        return self.along(self._views[index].to(self._tracer.device))

    def size(self, index: int, item: torch.Tensor) -> int:
        """Return the bytes that an image takes."""
        return item.numel() * item.element_size()

    @torch.no_grad()
    def along(self, view: TrainingView) -> torch.Tensor:
        """Return the image (4, H, W) of any view, such as that of a preview."""
        g = self._copy.gaussians
        extra = g.position.new_zeros(5, g.count)
        sums, _ = rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, view.camera, self._copy.bound.radius, 0)
        pixels = surface_pixels(sums, view.world_rays)
        depth = sums[-2].flatten()[pixels.index] / pixels.alpha
        centre = torch.as_tensor(view.camera.centre, dtype=torch.float32, device=depth.device)
        point = centre + view.world_rays.flatten(1)[:, pixels.index].T * depth[:, None]
        direction = reflect(pixels.view, pixels.normal).contiguous()
        passing, radiance = self._tracer.look(self._tracer.above(point, pixels.normal).contiguous(), direction)
        image = sums.new_zeros(4, sums[0].numel())
        image[0] = 1.0
        image[:, pixels.index] = torch.cat([passing[:, None], radiance], 1).T
        return image.view(4, *sums.shape[1:])

    def state(self) -> dict[str, torch.Tensor]:
        """Return the copy for a checkpoint; images are traced again."""
        return {**self._copy.gaussians.tensors(), "environment": self._copy.environment}

    @classmethod
    def of_state(cls, state: dict[str, torch.Tensor], now: Reconstruction, views: TrainingViewCache) -> InterReflections:
        """Return the images of a `state`; raise ValueError where it is not one.

        Args:
            state: as returned by `state`, or anything else.
            now: reconstruction of the same fit, whose other attributes are those of the copy.
            views: training views.
        """
        device, rest = now.environment.device, dict(state)
        light, gaussians = rest.pop("environment"), Gaussians(**rest)
        fits = light.shape == now.environment.shape
        for name, own in now.gaussians.tensors().items():
            fits = fits and rest[name].shape == (*own.shape[:-1], gaussians.count)
        if not fits or not all(t.dtype == torch.float32 and t.isfinite().all() for t in state.values()):
            raise ValueError("surfels of another fit")
        return cls(replace(now, gaussians=gaussians.to(device), environment=light.to(device)), views)
