# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel of deferred shading against PyTorch in float64, values and gradients."""

import pytest
import torch
from irgspp.core.rendering.deferred import radiance, reflective_radiance, reflective_radiance_reference, splat_radiance
from irgspp.core.shading.split_sum import LEVELS, specular_light

pytestmark = pytest.mark.usefixtures("engine")
SHAPE = (21, 30)
QUARTER = torch.tensor([[0.0, -0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])


def sums(seed=0):
    """Return random sums (13, H, W) of a rasteriser, with uncovered and faint pixels, and rays (3, H, W)."""
    generator = torch.Generator().manual_seed(seed)
    rays = torch.randn(3, *SHAPE, generator=generator)
    means = torch.rand(13, *SHAPE, generator=generator)
    means[3:6] = 0.4 * torch.randn(3, *SHAPE, generator=generator) - rays / rays.norm(dim=0)  # most face the camera
    alpha = torch.rand(SHAPE, generator=generator)
    alpha[:, :3], alpha[:, 3:6], alpha[:, 6:9] = 0.0, 2e-5, 0.04
    image = means * alpha
    image[-1] = alpha
    return image, rays


def computed(function, image, rays, stack, rotation, upstream, mirrored=None):
    """Return the value of a function of an image and a stack, and its gradients by both."""
    image, stack = image.clone().requires_grad_(), stack.clone().requires_grad_()
    out = function(image, rays, stack, rotation, mirrored)
    (out * upstream).sum().backward()
    assert image.grad is not None and stack.grad is not None
    return out.detach(), image.grad, stack.grad


@pytest.mark.parametrize(("rotation", "blocked"), [(None, False), (QUARTER, False), (QUARTER, True)], ids=["still", "turned", "blocked"])
def test_kernel_agrees_with_pytorch(rotation, blocked):
    image, rays = sums()
    generator = torch.Generator().manual_seed(1)
    stack = specular_light(torch.rand(16, 32, 3, generator=generator).square() * 3)
    upstream = torch.randn(3, *SHAPE, generator=generator)
    mirrored = torch.rand(4, *SHAPE, generator=generator) if blocked else None
    fast = computed(reflective_radiance, image, rays, stack, rotation, upstream, mirrored)
    doubles = [None if t is None else t.double() for t in (rotation, upstream, mirrored)]
    slow = computed(reflective_radiance_reference, image.double(), rays.double(), stack.double(), *doubles)
    for kernel, reference in zip(fast, slow, strict=True):
        assert (kernel - reference).norm() <= 1e-5 * reference.norm()


def test_materials_and_directions_at_their_limits_have_the_same_finite_gradient():
    """Roughness of 0, of 1 and at the levels; mirrored directions at a pole; normals that face away."""
    image, rays = sums()
    image[-1] = 1.0
    image[9] = torch.tensor([*LEVELS, 0.05, 0.9]).repeat(3)[: SHAPE[1]]
    rays[:, 0], image[3:6, 0] = torch.tensor([0.0, 0.0, -1.0])[:, None], torch.tensor([0.0, 0.0, 1.0])[:, None]
    image[3:6, 1] = rays[:, 1]
    stack = specular_light(torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(1)))
    fast = computed(reflective_radiance, image, rays, stack, None, torch.ones(3, *SHAPE))
    slow = computed(reflective_radiance_reference, image, rays, stack, None, torch.ones(3, *SHAPE))
    assert all(values.isfinite().all() for values in fast)
    fast[1][:, 0] = slow[1][:, 0]  # exactly at a pole the gradient is any
    for kernel, reference in zip(fast, slow, strict=True):
        assert (kernel - reference).norm() <= 1e-3 * reference.norm()


def test_without_a_light_the_kernel_divides_by_opacity():
    image, rays = sums()
    image, upstream = image[[0, 1, 2, 3, 4, 5, 11, 12]], torch.randn(3, *SHAPE, generator=torch.Generator().manual_seed(1))
    fast, slow = image.clone().requires_grad_(), image.double().requires_grad_()
    shown, expected = radiance(fast, rays, None), splat_radiance(slow)
    (shown * upstream).sum().backward()
    (expected * upstream).sum().backward()
    assert fast.grad is not None and slow.grad is not None
    assert (shown - expected).norm() <= 1e-6 * expected.norm() and (fast.grad - slow.grad).norm() <= 1e-6 * slow.grad.norm()


def test_the_light_has_the_same_gradient_in_any_order_of_pixels(engine):
    """Threads of a GPU arrive in any order; the sums of their integers are the same bit by bit."""
    if engine == "numba":
        pytest.skip("ranges of pixels are summed in order")
    image, rays = sums()
    generator = torch.Generator().manual_seed(1)
    stack, upstream = specular_light(torch.rand(16, 32, 3, generator=generator)), torch.randn(3, *SHAPE, generator=generator)
    one = computed(reflective_radiance, image, rays, stack, None, upstream)[2]
    turned = [t.flip(1, 2).contiguous() for t in (image, rays, upstream)]
    other = computed(reflective_radiance, *turned[:2], stack, None, turned[2])[2]
    assert torch.equal(one, other)


def test_a_gradient_that_is_nan_is_seen_in_that_of_the_light():
    image, rays = sums()
    stack = specular_light(torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(1)))
    upstream = torch.ones(3, *SHAPE)
    upstream[0, -1, -1] = torch.nan
    assert computed(reflective_radiance, image, rays, stack, None, upstream)[2].isnan().any()
