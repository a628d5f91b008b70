# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused loss of a masked view against the sum of the losses in float64, values and gradients."""

import math
from dataclasses import replace

import pytest
import torch
from irgspp.core.kernels.normal_consistency import normal_consistency_reference
from irgspp.core.kernels.reference.photometric import photometric_reference
from irgspp.core.stages.common import image_loss as module
from irgspp.core.stages.common.image_loss import LossWeights, displayed, image_loss, image_loss_reference
from irgspp.core.stages.common.training_view import TrainingView, camera_rays

pytestmark = pytest.mark.usefixtures("engine")
WEIGHTS = LossWeights(mask=0.5, normal=0.2, edge=0.2)


@pytest.fixture(params=[(24, 31), (9, 3), (16, 16)], ids=str)
def rendered(request, camera_ring):
    """A view with a mask, saturated values and a crop, and straight radiance and sums that a renderer could make of it."""
    height, width = request.param
    camera, generator = camera_ring(3, size=32)[1], torch.Generator().manual_seed(height)
    rays = camera_rays(camera)[:, :height, :width].contiguous()
    rotation = torch.as_tensor(camera.world_to_cv[:3, :3].copy(), dtype=torch.float32)
    mask = torch.rand(height, width, generator=generator)
    mask[: height // 3] = 0
    saturated = (torch.rand(3, height, width, generator=generator) < 0.3) & (mask > 0)
    view = TrainingView(
        camera, torch.rand(3, height, width, generator=generator), mask, saturated, rays, rays, rotation, pixel_fraction=0.3
    )
    straight = 2 * torch.rand(3, height, width, generator=generator).square()
    straight[:, 0, 0], straight[:, 1, 1], straight[:, 2, 2] = -0.1, 0.0, 0.003
    sums = torch.rand(13, height, width, generator=generator)
    sums[-1], sums[-2] = torch.rand(height, width, generator=generator), sums[-2] + 3
    return straight, sums, view


def in_double(view):
    """The same view in float64."""
    layers = {name: getattr(view, name).double() for name in ("image", "alpha", "rays", "world_rays", "rotation")}
    return replace(view, **layers)


def gradients(function, straight, sums, view):
    """Return the value of a loss, and 3 times its gradients by straight radiance and sums."""
    straight, sums = straight.clone().requires_grad_(), sums.clone().requires_grad_()
    loss = function(straight, sums, view, None, WEIGHTS)
    (3 * loss).backward()
    return loss, straight.grad, sums.grad


def test_kernel_agrees_with_the_reference(rendered, monkeypatch):
    straight, sums, view = rendered
    monkeypatch.setattr(module, "photometric_loss", photometric_reference)
    monkeypatch.setattr(module, "normal_consistency", normal_consistency_reference)
    loss, *fast = gradients(image_loss, straight, sums, view)
    exact, *slow = gradients(image_loss_reference, straight.double(), sums.double(), in_double(view))
    assert loss.item() == pytest.approx(exact.item(), rel=1e-5)
    for kernel, reference in zip(fast, slow, strict=True):
        for channel in range(len(kernel)):
            assert (kernel[channel] - reference[channel]).norm() <= 1e-4 * reference[channel].norm(), channel


def test_image_that_is_not_finite_has_no_finite_loss(rendered):
    straight, sums, view = rendered
    for bad in (math.nan, math.inf):
        broken = straight.clone()
        broken[1, -1, -1] = bad
        assert not image_loss(broken, sums, replace(view, saturated=torch.zeros_like(view.saturated)), None, WEIGHTS).isfinite()


def test_views_without_an_exact_mask_have_the_same_loss_in_parts(rendered):
    """A mask with a band that is empty is an exact mask, but the fused kernel does not know it."""
    straight, sums, view = rendered
    banded = replace(view, band=torch.zeros_like(view.alpha, dtype=torch.bool), background=torch.ones_like(view.image))
    assert image_loss(straight, sums, banded, None, WEIGHTS).item() == pytest.approx(
        image_loss(straight, sums, view, None, WEIGHTS).item(), rel=1e-5
    )
    background = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0))
    open_view = replace(view, alpha=None)
    assert displayed(straight, sums[-1], open_view, background).isfinite().all()
    assert image_loss(straight, sums, open_view, background, WEIGHTS).isfinite()
