# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians of any size, shape, opacity and position: the rasteriser and the ray tracer against their float64 references."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from irgspp.core.kernels.constants import NEAR
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.trace import hit_lists, trace, transmittance

from .case import Measured, group
from .references import ALLOWED, Limits, compare_images, compare_rays
from .surfel_scenes import GEOMETRY, Rays, Surfels, aimed, camera, cloud, quaternions_of, scattered, towards
from .threads import threads_set_to

case = group("gaussians")
AGREE = "Sums and gradients are finite and equal those of the float64 references, "
IDENTITY = torch.tensor([1.0, 0.0, 0.0, 0.0])


def compare_both(
    measured: Measured, what: str, values: Surfels, reference: Surfels | None = None, rays: Rays | None = None, limits: Limits = ALLOWED
) -> None:
    """Compare images and rays with the float64 references.

    Args:
        measured: result of the case.
        what: name of the scene.
        values: surfels.
        reference: surfels that the references get; None: the same.
        rays: origins and directions (R, 3); None: scattered ones.
        limits: what the comparison allows.
    """
    compare_images(measured, what, values, camera(), 1.0, reference, limits)
    compare_rays(measured, what, values, rays or scattered(300), reference, limits)


@case("scales of 1e-7 to 1e3 of the scene", AGREE + "for each size and for all of them in one scene.")
def scales(measured: Measured) -> None:
    """Check the range of scales."""
    mixed = cloud(48)
    mixed["log_scale"] = torch.linspace(math.log(1e-7), math.log(1e3), 48).repeat(2, 1)
    compare_both(measured, "all", mixed)
    for size in (1e-7, 1e-4, 1.0, 1e3):
        values = cloud(24, 1, size)
        compare_both(measured, f"{size:g}", values, rays=aimed(values, 10 * size))


@case("aspect of 1e6", AGREE + "for needles 1 long and 1e-6 wide, 1e-3 and 1e-9, 1e3 and 1e-3.")
def needles(measured: Measured) -> None:
    """Check extreme aspects."""
    for length in (1.0, 1e-3, 1e3):
        values = cloud(24, 2)
        values["log_scale"] = torch.tensor([[math.log(length)], [math.log(length) - math.log(1e6)]]).repeat(1, 24)
        compare_both(measured, f"{length:g}", values, rays=aimed(values, 10 * length))


@case("opacity 0, 1e-8, 1 - 1e-7 and 1", AGREE + "0 and 1 given as infinite logits; surfels of opacity 0 and 1e-8 change no bit.")
def opacities(measured: Measured) -> None:
    """Check extreme opacities."""
    for opacity in (0.0, 1e-8, 1 - 1e-7, 1.0):
        values = cloud(60, 3)
        values["opacity"][:20] = torch.logit(torch.tensor(opacity, dtype=torch.float64)).float()
        compare_both(measured, f"{opacity:g}", values)
        if opacity < 0.5:
            rest = {name: value[..., 20:].contiguous() for name, value in values.items()}
            same = all(torch.equal(a, b) for a, b in zip(_render_both(values), _render_both(rest), strict=True))
            measured.holds(f"opacity {opacity:g} changes nothing", same)


def _render_both(values: Surfels) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the image of the surfels, (C, 24, 24), and what rays through them meet, (300, C)."""
    tree = SurfelTree.build(*(values[name] for name in GEOMETRY))
    return rasterize(*values.values(), camera(), 1.0)[0], trace(*values.values(), *scattered(300), tree)


@case("exactly coincident surfels", AGREE + "where 40 surfels are the same but for colour and opacity; ties go by the surfels' numbers.")
def coincident(measured: Measured) -> None:
    """Check coincident surfels."""
    values = cloud(60, 4, 0.4)
    values["position"][:, :40], values["log_scale"][:, :40] = 0.0, -1.0
    values["quaternion"][:, :40] = IDENTITY[:, None]  # their planes are z = 0 exactly: no rounding error breaks the tie
    values["opacity"][:40] -= 3.0
    compare_both(
        measured, "coincident", values, limits=Limits(perturbed=("log_scale", "opacity"))
    )  # noise in positions would break the tie


@case(
    "4096 surfels at one depth", AGREE + "more than the tracer's buffer of nearest hits holds, of which none may be lost or counted twice."
)
def one_depth(measured: Measured) -> None:
    """Check many surfels at one depth."""
    values = cloud(4096, 5, 1.0)
    values["position"][2] = 0.0
    values["quaternion"][:] = IDENTITY[:, None]
    values["opacity"] -= 8.0
    values["opacity"][::7] = -5.2  # visible, and so faint that each ray meets hundreds of them
    values["log_scale"] += 0.5
    above = camera(8, (0.0, 0.0, 4.0))
    flat = Limits(0.2, perturbed=("log_scale", "opacity"))  # each ray passes hundreds of edges
    compare_images(measured, "4096", values, above, limits=flat)
    rays = towards(np.array([0.0, 0.0, 4.0]), torch.tensor([[0.013 * i, 0.02 * i - 0.3, 0.0] for i in range(32)]))
    compare_rays(measured, "4096", values, rays, limits=flat)
    tree = SurfelTree.build(*(values[name] for name in GEOMETRY))
    lists = hit_lists(tree, *rays)
    twice = max(int(np.bincount(lists.index[a:b]).max(initial=0)) for a, b in zip(lists.start[:-1], lists.start[1:], strict=True))
    measured.at_least("most hits of a ray", float(np.diff(lists.start).max()), 300)
    measured.at_most("times a ray meets one surfel", twice, 1)


@case("edge-on", AGREE + "for surfels whose normals are perpendicular to the ray to their centres, to 0, 1e-7, 1e-5, 1e-3.")
def edge_on(measured: Measured) -> None:
    """Check surfels seen edge-on."""
    eye = np.array([3.0, 1.25, 2.0])
    for lean in (0.0, 1e-7, 1e-5, 1e-3):
        values = cloud(40, 6)
        sight = torch.nn.functional.normalize(values["position"] - torch.tensor(eye).float()[:, None], dim=0)
        aside = torch.nn.functional.normalize(
            torch.linalg.cross(sight, torch.randn(3, 40, generator=torch.Generator().manual_seed(1)), dim=0), dim=0
        )
        values["quaternion"] = quaternions_of(aside + lean * sight)
        compare_both(measured, f"{lean:g}", values, limits=Limits(tries=16))


@case(
    "behind, at and around the camera",
    AGREE + "for surfels behind it, with their centre in it, and so wide that they reach round it.",
)
def around_the_camera(measured: Measured) -> None:
    """Check surfels behind and around the camera."""
    view, values = camera(), cloud(48, 7, 0.3)
    eye, forward = torch.tensor(view.centre).float(), torch.tensor(view.forward).float()
    for i, depth in enumerate((-2.0, -0.01, 0.0, 0.5)):
        values["position"][:, i] = eye + depth * forward
    values["log_scale"][:, 3:10] = 1.5  # reach beyond the camera on all sides
    reference = values | {"position": values["position"].clone()}
    reference["position"][:, 2] = eye - 2 * forward  # the reference has no direction to a surfel in the camera
    compare_images(measured, "surfels", values, view, reference=reference)
    compare_rays(measured, "surfels", values, scattered(300))
    compare_rays(measured, "from the camera", values, towards(view.centre, values["position"].T[8:]))


@case("on the near plane", AGREE + "for surfels on the near plane exactly, which are not seen, and one rounding before and behind it.")
def near_plane(measured: Measured) -> None:
    """Check surfels at the near plane."""
    view, near = camera(16, (0.0, 0.0, 4.0)), 0.03125
    values = cloud(12, 14, 0.3)
    plane = torch.full((3,), 4.0 - near)
    values["position"][:, :9] *= 0.01
    values["position"][2, :9] = torch.cat([plane, plane.nextafter(torch.zeros(())), plane.nextafter(torch.full((), 9.0))])
    values["log_scale"][:, :9] -= 4.0
    compare_images(measured, "surfels", values, view, near / NEAR, limits=Limits(perturbed=GEOMETRY[1:]))
    radius = rasterize(*values.values(), view, near / NEAR)[1].radius > 0
    measured.holds("seen: exactly those behind the plane", radius[:9].tolist() == [False] * 3 + [True] * 3 + [False] * 3)


@case(
    "rays on, along and of no direction",
    "A ray that starts on a surfel doesn't meet it; one within a surfel's plane meets nothing of it; one of direction 0 meets nothing; "
    "sums and gradients are finite.",
)
def odd_rays(measured: Measured) -> None:
    """Check rays on and along surfels, and rays without a direction."""
    values = cloud(40, 8, 0.3)
    values["quaternion"][:] = IDENTITY[:, None]
    values["opacity"][:] = 2.0
    values["position"][2] = torch.arange(40) / 64  # planes that float32 represents exactly
    up, along = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.6, 0.8, 0.0])
    on = values["position"].T.clone()
    kinds = {"on": (on, up.expand_as(on)), "along": (on, along.expand_as(on)), "none": (on, torch.zeros_like(on))}
    tree = SurfelTree.build(*(values[name] for name in GEOMETRY))
    for name, rays in kinds.items():
        leaves = [v.detach().clone().requires_grad_() for v in (*values.values(), *(r.contiguous() for r in rays))]
        out = trace(*leaves, tree=tree)
        out.square().sum().backward()
        lists = hit_lists(tree, *(r.contiguous() for r in rays))
        own = sum(int(i in lists.index[lists.start[i] : lists.start[i + 1]]) for i in range(40))
        measured.at_most(f"{name}: rays that meet the surfel they start on", own, 0)
        measured.finite(f"{name}: sums and gradients", [out, *(leaf.grad for leaf in leaves)])
        measured.finite(f"{name}: transmittance", transmittance(tree, *(r.contiguous() for r in rays)))
        if name != "on":
            measured.at_most(f"{name}: hits", len(lists.index), 0)
    fixed = Limits(perturbed=("log_scale", "opacity", "direction"))
    compare_rays(measured, "on", values, (on, up.expand_as(on).contiguous()), limits=fixed)
    compare_rays(measured, "just above", values, (on + 1e-3 * up, scattered(40)[1]), limits=fixed)


@case(
    "scene at 1e5 from the origin",
    AGREE + "for a scene of size 1 moved by 1e5 along each axis, where float32 positions are rounded to 1/128: that scene's results match.",
)
def far_away(measured: Measured) -> None:
    """Check a scene far from the origin."""
    values = cloud(60, 9, 0.3)
    offset = 1e5
    values["position"] += offset
    eye = (offset + 3.0, offset + 1.25, offset + 2.0)
    compare_images(measured, "far", values, camera(24, eye, (offset, offset, offset)))
    origin, direction = scattered(300)
    compare_rays(measured, "far", values, (origin + offset, direction))


@case("0, 1 and 2 Gaussians", AGREE + "and an empty scene gives a black, transparent image.")
def few(measured: Measured) -> None:
    """Check scenes of few surfels."""
    for count in (1, 2, 7):
        values = cloud(count, 10, 0.5)
        values["position"] *= 0.3
        compare_both(measured, str(count), values)
    none = cloud(0, 10)
    image, along = _render_both(none)
    measured.holds("none: an empty image", image.shape == (10, 24, 24) and not image.any())
    measured.holds("none: rays meet nothing", along.shape == (300, 10) and not along.any())


@case(
    "quaternions of any length, and zero",
    AGREE + "for lengths of 1e-9 to 1e18; at length 0 a surfel is not rotated, and its gradients are finite.",
)
def quaternions(measured: Measured) -> None:
    """Check quaternions of any length."""
    for length in (1e-9, 1e-3, 1e6, 1e18):
        values = cloud(40, 11)
        values["quaternion"] = length * torch.nn.functional.normalize(values["quaternion"], dim=0)
        compare_both(measured, f"{length:g}", values)
    values = cloud(40, 11)
    values["quaternion"][:, :10] = 0.0
    reference = values | {"quaternion": torch.where(torch.arange(40) < 10, IDENTITY[:, None], values["quaternion"])}
    _compare_zero_quaternions(measured, values, reference)


def _compare_zero_quaternions(measured: Measured, values: Surfels, reference: Surfels) -> None:
    """Check that zero quaternions give the sums of the identity, and finite gradients."""
    for what, zero, unit in zip(("image", "rays"), _render_both(values), _render_both(reference), strict=True):
        measured.at_most(f"zero, {what}: error", float((zero - unit).abs().max()), 1e-6)
    leaves = {name: value.clone().requires_grad_() for name, value in values.items()}
    sum(seen.square().sum() for seen in _render_both(leaves)).backward()  # type: ignore[union-attr]
    measured.finite("zero: gradients", [leaf.grad for leaf in leaves.values()])


@case(
    "same bits every time",
    "Sums and gradients of a scene with all of these are the same bits when repeated, and within 1e-5 of it on 1, 2, 3 and 5 threads.",
)
def repeated(measured: Measured) -> None:
    """Check repeated runs and other numbers of threads."""
    values = cloud(400, 12)
    values["log_scale"] = torch.linspace(math.log(1e-4), math.log(10), 400).repeat(2, 1)
    values["quaternion"][:, :5] = 0.0
    first = _sums_and_gradients(values)
    measured.holds("same bits when repeated", all(torch.equal(a, b) for a, b in zip(first, _sums_and_gradients(values), strict=True)))
    apart = 0.0
    for threads in (1, 2, 3, 5):
        with threads_set_to(threads):
            for one, other in zip(first, _sums_and_gradients(values), strict=True):
                apart = max(apart, float((one - other).norm() / one.norm()))
    measured.at_most("apart on other numbers of threads", apart, 1e-5)


def _sums_and_gradients(values: Surfels) -> list[torch.Tensor]:
    """Return all sums of image and rays, and the gradients of their squares."""
    leaves = {name: value.clone().requires_grad_() for name, value in values.items()}
    seen = _render_both(leaves)
    sum(s.square().sum() for s in seen).backward()  # type: ignore[union-attr]
    return [*(s.detach() for s in seen), *(leaf.grad for leaf in leaves.values() if leaf.grad is not None)]


@case(
    "300,000 Gaussians",
    AGREE + "on 16 pixels and 16 rays of a scene with 300,000 (to 1e-3: a unit in the last place of their distance is 1e-4 of their size).",
    quick=False,
)
def many(measured: Measured) -> None:
    """Check a large scene."""
    values, limits = cloud(300_000, 13, 0.004), Limits(0.3, 1e-3, tries=2)
    close = replace(camera(4), fx=300.0, fy=300.0)
    origin, direction = scattered(16)
    for half in range(2):  # because of the references' memory
        strip = replace(close, height=2, cy=close.cy - 2 * half)
        compare_images(measured, f"half {half + 1}", values, strip, limits=limits)
        part = slice(8 * half, 8 * half + 8)
        compare_rays(measured, f"half {half + 1}", values, (origin[part], direction[part]), limits=limits)
