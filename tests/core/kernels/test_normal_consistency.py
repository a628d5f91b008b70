# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of analytic depth, and the normal consistency loss: the reference against finite differences, the kernel against it."""

import math

import pytest
import torch
from irgspp.core.kernels.normal_consistency import depth_normals, normal_consistency, normal_consistency_reference
from irgspp.core.stages.common.training_view import camera_rays

pytestmark = pytest.mark.usefixtures("engine")


@pytest.fixture(scope="module")
def camera(camera_ring):
    return camera_ring(5, size=32)[2]


@pytest.fixture(scope="module")
def rotation(camera):
    return torch.as_tensor(camera.world_to_cv[:3, :3].copy())


def plane(camera):
    """Return rays, depth and camera-space normal of a tilted plane."""
    rays = camera_rays(camera).double()
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, -1.0]).double(), dim=0)
    return rays, -4.0 / torch.einsum("c,chw->hw", normal, rays), normal


def sums(camera, rotation, alpha=0.8):
    """Return the sums that the rasteriser would compute of that plane, and the rays."""
    rays, depth, normal = plane(camera)
    image = torch.rand(8, *depth.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    image[3:6] = alpha * (rotation.T @ normal)[:, None, None]
    image[-2], image[-1] = alpha * depth, alpha
    return image, rays


def test_normals_of_a_plane_are_exact(camera):
    rays, depth, normal = plane(camera)
    assert (depth_normals(depth, rays) - normal[:, None, None]).abs().max() < 1e-9


def test_normals_of_a_sphere(camera):
    rays = camera_rays(camera).double()
    a, b = rays.square().sum(0), 4 * rays[2]
    root = b * b - a * (16 - 1)
    depth = (b - root.clamp_min(0).sqrt()) / a
    exact = rays * depth - torch.tensor([0, 0, 4.0])[:, None, None]
    inside = (root > 0.3)[1:-1, 1:-1]
    assert inside.sum() > 50
    cosine = (depth_normals(depth, rays) * exact[:, 1:-1, 1:-1]).sum(0)[inside]
    assert cosine.min() > 0.995


def test_plane_of_splats_costs_nothing(camera, rotation):
    image, rays = sums(camera, rotation)
    assert abs(normal_consistency(image, rays, rotation)) < 1e-9
    image[3:6] *= -1  # all reversed: 1 - cos = 2
    inner = (camera.width - 2) * (camera.height - 2) / (camera.width * camera.height)
    assert normal_consistency(image, rays, rotation).item() == pytest.approx(2 * 0.8 * inner, rel=1e-6)


def test_disagreement_as_large_as_an_edge_counts_half(camera, rotation):
    image, rays = sums(camera, rotation)
    image[3:6] *= -1
    whole = normal_consistency(image, rays, rotation).item()
    assert normal_consistency(image, rays, rotation, edge=2 * 0.8).item() == pytest.approx(whole / 2, rel=1e-6)
    assert normal_consistency(image, rays, rotation, edge=1e6).item() == pytest.approx(whole, rel=1e-5)


@pytest.mark.parametrize("edge", [math.inf, 0.2])
def test_gradient_is_that_of_finite_differences(camera, rotation, edge):
    whole, rays = sums(camera, rotation)
    image, rays = whole[:, 10:16, 8:14].clone(), rays[:, 10:16, 8:14]
    generator = torch.Generator().manual_seed(1)
    image += 0.02 * torch.randn(image.shape, generator=generator, dtype=torch.float64)
    weight = image[-1].clone()  # the outer opacity is a constant to the gradient

    def loss(changed):
        value = normal_consistency(changed, rays, rotation, edge)
        return value - (changed[-1].detach() - weight)[1:-1, 1:-1].sum() / weight.numel()

    leaf = image.clone().requires_grad_()
    loss(leaf).backward()
    assert leaf.grad is not None
    for channel in (3, 4, 5, 6, 7) if math.isinf(edge) else (3, 4, 5, 6):
        for row, column in ((1, 1), (2, 4), (5, 3)):
            shifted = [image.clone() for _ in range(2)]
            for p, sign in zip(shifted, (1, -1), strict=True):
                p[channel, row, column] += sign * 1e-6
            numeric = (loss(shifted[0]) - loss(shifted[1])) / 2e-6
            assert leaf.grad[channel, row, column].item() == pytest.approx(numeric.item(), abs=1e-8, rel=1e-4)
    assert leaf.grad[:3].abs().max() == 0
    assert leaf.grad[-1].abs().max() > 0  # opacity alone must not make the surface look deeper


@pytest.mark.parametrize("edge", [math.inf, 0.2])
@pytest.mark.parametrize("shape", [(8, 21, 30), (13, 9, 12), (8, 3, 3)])
def test_kernel_agrees_with_the_reference(camera, rotation, shape, edge):
    height, width = shape[1:]
    image = torch.rand(shape, generator=torch.Generator().manual_seed(height))
    image[-2] += 3 * image[-1]
    image[-1, : height // 3] = 1e-4  # hardly covered: opacity below which depths are not divided by it
    image[:, -1] = 0.0
    rays = camera_rays(camera)[:, :height, :width]
    fast, slow = image.clone().requires_grad_(), image.double().requires_grad_()
    a = normal_consistency(fast, rays, rotation.float(), edge)
    b = normal_consistency_reference(slow, rays.double(), rotation.double(), edge)
    (3 * a).backward()
    (3 * b).backward()
    assert fast.grad is not None and slow.grad is not None
    assert a.item() == pytest.approx(b.item(), rel=1e-5, abs=1e-6)
    assert (fast.grad - slow.grad).norm() <= 1e-4 * slow.grad.norm()
