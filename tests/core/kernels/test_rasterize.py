# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasteriser against brute force in float64."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.reference.rasterize import rasterize_reference
from irgspp.core.scene.camera import Camera, look_at

NAMES = ("position", "quaternion", "log_scale", "opacity", "sh", "extra")
pytestmark = pytest.mark.usefixtures("engine")


def camera(width=37, height=29, off_centre=(2.5, -1.5)):
    direction = np.array([math.cos(0.7) * math.cos(0.3), math.cos(0.7) * math.sin(0.3), math.sin(0.7)])
    return Camera(width, height, 52.0, 49.0, width / 2 + off_centre[0], height / 2 + off_centre[1], look_at(4 * direction))


def cloud(n, seed, extras=2, size=0.12):
    g = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    return [
        random(3, n) * 0.6,
        random(4, n),
        math.log(size) + random(2, n) * 0.5,
        random(n) * 1.5,
        random(16, 3, n) * 0.3,
        torch.rand(extras, n, generator=g),
    ]


def both(parameters, cam, degree=3):
    fast = [p.clone().float().requires_grad_() for p in parameters]
    slow = [p.clone().double().requires_grad_() for p in parameters]
    return fast, slow, rasterize(*fast, cam, 1.0, degree)[0], rasterize_reference(*slow, cam, 1.0, degree)


@pytest.mark.parametrize(("n", "degree"), [(8, 0), (61, 3), (400, 2)])
def test_forward_matches_reference(n, degree):
    _, _, fast, slow = both(cloud(n, n), camera(), degree)
    error = (fast - slow).abs().amax(0)
    # A pixel at the edge of a cut-off may fall on either side of it; its error is at most ALPHA_MIN times the range of a channel.
    assert (error > 1e-4).float().mean() < 2e-3
    assert error.max() < 0.05


@pytest.mark.parametrize(("seed", "degree"), [(1, 3), (2, 3), (3, 1)])
def test_gradients_match_autograd(seed, degree):
    fast, slow, a, b = both(cloud(80, seed), camera(), degree)
    weight = torch.randn(a.shape, generator=torch.Generator().manual_seed(9))
    agree = ((a - b).abs().amax(0) < 1e-4).float()  # pixels on a threshold differ by design
    (a * weight * agree).sum().backward()
    (b * weight.double() * agree).sum().backward()
    for name, f, s in zip(NAMES, fast, slow, strict=True):
        relative = (f.grad - s.grad).norm() / s.grad.norm()
        assert relative < 2e-4, f"{name}: {relative:.1e}"


@pytest.fixture
def poisoned_memory():
    """Fill uninitialised tensors with NaN."""
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_unused_coefficients_get_no_gradient(poisoned_memory, degree):
    parameters = [p.clone().requires_grad_() for p in cloud(40, 3)]
    rasterize(*parameters, camera(), 1.0, degree)[0].sum().backward()
    used = (degree + 1) ** 2
    gradient = parameters[4].grad
    assert gradient is not None and gradient[:used].abs().sum() > 0
    assert not gradient[used:].any()
    assert all(torch.isfinite(p.grad).all() for p in parameters if p.grad is not None)


def test_edge_on_and_degenerate_surfels_stay_finite():
    parameters = cloud(64, 5)
    cam = camera()
    parameters[0][:, 0] = torch.as_tensor(cam.centre)  # in the camera
    parameters[0][:, 1] = torch.as_tensor(cam.centre * 2)  # behind it
    parameters[3][2] = -100.0  # invisible
    parameters[2][:, 3] = -30.0  # a point
    parameters[1][:, 4] = 0.0  # no orientation
    fast = [p.clone().requires_grad_() for p in parameters]
    image, statistics = rasterize(*fast, cam, 1.0)
    image.square().sum().backward()
    assert torch.isfinite(image).all()
    assert all(torch.isfinite(f.grad).all() for f in fast)
    assert statistics.radius[1] == 0 and statistics.radius[2] == 0
    assert statistics.gradient is not None and statistics.gradient.shape == (64,)


def test_same_input_same_bits():
    parameters = cloud(300, 7)
    first = [p.clone().requires_grad_() for p in parameters]
    second = [p.clone().requires_grad_() for p in parameters]
    for p in (first, second):
        rasterize(*p, camera(), 1.0)[0].square().sum().backward()
    assert all(torch.equal(a.grad, b.grad) for a, b in zip(first, second, strict=True))


def test_facing_surfel_has_its_depth_normal_and_opacity():
    pose = np.eye(4)
    pose[2, 3] = 3.0  # looks down -Z at the origin
    cam = Camera(16, 16, 20.0, 20.0, 8.5, 8.5, pose)  # the centre of pixel (8, 8)
    n = 8
    sh = torch.zeros(16, 3, n)
    sh[0] = 0.5 / 0.28209479177387814
    position = torch.zeros(3, n)
    position[0, 1:] = 50.0  # the others are out of sight
    upright = torch.tensor([1.0, 0, 0, 0])[:, None].repeat(1, n)
    image, _ = rasterize(position, upright, torch.zeros(2, n), torch.full((n,), 2.0), sh, torch.zeros(0, n), cam, 1.0)
    alpha = image[-1, 8, 8]
    assert alpha == pytest.approx(torch.tensor(2.0).sigmoid().item(), abs=1e-3)
    assert (image[:3, 8, 8] / alpha).tolist() == pytest.approx([1.0, 1.0, 1.0], abs=1e-5)
    assert (image[3:6, 8, 8] / alpha).tolist() == pytest.approx([0.0, 0.0, 1.0], abs=1e-5)
    assert image[6, 8, 8] / alpha == pytest.approx(3.0, abs=1e-5)


def test_subpixels_are_means_over_a_finer_image():
    parameters, cam = cloud(120, 5), camera(12, 10, (0.5, -0.25))
    image, statistics = rasterize(*parameters, cam, 1.0, subpixels=3)
    fine, finer = rasterize(*parameters, cam.resized(36, 30), 1.0)
    assert torch.allclose(image, fine.unflatten(2, (12, 3)).unflatten(1, (10, 3)).mean((2, 4)), atol=1e-6)
    assert torch.allclose(statistics.radius * 3, finer.radius)


def test_gradients_of_subpixels_match_autograd():
    parameters = cloud(40, 6)
    fast, slow = [p.clone().requires_grad_() for p in parameters], [p.clone().double().requires_grad_() for p in parameters]
    image, statistics = rasterize(*fast, camera(12, 10), 1.0, subpixels=2)
    reference = rasterize_reference(*slow, camera(12, 10).resized(24, 20), 1.0)
    weight = torch.randn(image.shape, generator=torch.Generator().manual_seed(2))
    (image * weight).sum().backward()
    (reference.unflatten(2, (12, 2)).unflatten(1, (10, 2)).mean((2, 4)) * weight).sum().backward()
    for name, f, s in zip(NAMES, fast, slow, strict=True):
        assert (f.grad - s.grad).norm() < 1e-2 * s.grad.norm(), name
    assert statistics.gradient is not None


@pytest.mark.parametrize(("degrees", "flipped"), [(0, False), (80, False), (100, False), (120, True), (180, True)])
def test_normal_is_flipped_only_where_it_points_well_away(degrees, flipped):
    turn = math.radians(degrees) / 2
    one = [torch.zeros(3, 8), torch.zeros(4, 8), torch.full((2, 8), -1.0), torch.full((8,), 3.0), torch.zeros(1, 3, 8), torch.zeros(0, 8)]
    one[0][:, 1:] = 50.0  # the others lie outside the image
    one[1][0], one[1][1] = math.cos(turn), math.sin(turn)  # +z, turned about x
    image, _ = rasterize(*one, Camera(9, 9, 40.0, 40.0, 4.5, 4.5, look_at((0, 0, 4), up=(0, 1, 0))), 1.0, 0)
    expected = torch.tensor([0.0, -math.sin(2 * turn), math.cos(2 * turn)]) * (-1 if flipped else 1)
    assert torch.allclose(image[3:6, 4, 4] / image[-1, 4, 4], expected, atol=1e-4)
