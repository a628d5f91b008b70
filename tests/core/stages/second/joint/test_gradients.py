# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradients of a whole joint step, from surfels and light to the loss, against finite differences in float64."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from irgspp.core.scene.dataset import View
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.stages.common.training_view import make_training_view
from irgspp.core.stages.second.joint.losses import LOW_GLOSS_WEIGHTS, joint_losses
from irgspp.core.stages.second.joint.model import JointModel
from joint_scene import COUNT, REFERENCE, bowl, camera, disc, log_light, random_image, to_double

GROUPS = {
    "position": ("position", slice(None)),
    "scale": ("log_scale", slice(None)),
    "rotation": ("quaternion", slice(None)),
    "opacity": ("opacity", slice(None)),
    "SH dc": ("sh", slice(0, 1)),
    "SH rest": ("sh", slice(1, None)),
    "albedo": ("material", slice(0, 3)),
    "roughness": ("material", slice(3, 4)),
    "metallic": ("material", slice(4, 5)),
    "light": ("light", slice(None)),
}
WEIGHTS = replace(LOW_GLOSS_WEIGHTS, distortion=5.0)  # which is published with the weight 0
STEP = 1e-6
ENTRIES = 6  # of each group that are moved one by one, besides all at once


class Step:
    """One joint step with fixed pixels and samples, as a function of surfels and light, in float64 or by the float32 kernels."""

    def __init__(self):
        image = random_image()
        self.view = make_training_view(View("0", camera(), Path("0.png"), image.permute(1, 2, 0).numpy(), disc()))
        self.values = {**bowl().tensors(), "light": log_light()}
        constants = (1.5, torch.zeros(3), torch.ones(COUNT, dtype=torch.bool), None, None)
        fast = JointModel(*constants, 2, distortion=True)
        self.models = {torch.float32: fast, torch.float64: replace(fast, kernels=REFERENCE)}
        model, gaussians = self.models[torch.float32], bowl()
        sums = model.render(gaussians, self.view)
        pixels = model.foreground(sums, self.view)[::3]
        self.plan = model.plan(sums, self.view, pixels, log_light().exp(), (8, 4, 4), torch.Generator().manual_seed(0))

    def losses(self, values, constant=False):
        """Losses by name; `constant` leaves out what has no gradient by design."""
        dtype = values["light"].dtype
        model, view, plan = self.models[dtype], self.view, self.plan
        if dtype == torch.float64:
            view, plan = to_double(view), type(plan)(plan.pixels, to_double(plan.samples), plan.above)
        gaussians = Gaussians(**{name: value for name, value in values.items() if name != "light"})
        sums = model.render(gaussians, view)
        losses = joint_losses(model, gaussians, values["light"], sums, view, plan, WEIGHTS, geometry=True)
        # Normal consistency does not follow its outer opacity (2DGS), which a difference of its values does: that part is taken out.
        outer = sums[-1, 1:-1, 1:-1].sum() / sums[-1].numel()
        if constant:
            losses["normal"] = losses["normal"] - LOW_GLOSS_WEIGHTS.normal * view.pixel_fraction * outer
        return losses

    def gradient(self, dtype, names=None):
        values = {name: value.to(dtype, copy=True).requires_grad_() for name, value in self.values.items()}
        losses = self.losses(values)
        torch.stack([value for name, value in losses.items() if names is None or name in names]).sum().backward()
        return {name: torch.zeros_like(value) if value.grad is None else value.grad for name, value in values.items()}

    def slope(self, name, direction):
        """Central difference of the float64 loss along a direction of one tensor."""
        moved = []
        for sign in (STEP, -STEP):
            values = {key: value.double() for key, value in self.values.items()}
            values[name] = values[name] + sign * direction
            moved.append(torch.stack(list(self.losses(values, constant=True).values())).sum())
        return float(moved[0] - moved[1]) / (2 * STEP)


@pytest.fixture(scope="module")
def step():
    return Step()


@pytest.fixture(scope="module")
def gradients(step):
    return {dtype: step.gradient(dtype) for dtype in (torch.float32, torch.float64)}


def test_the_scene_has_shadow_indirect_light_and_all_losses(step):
    values = {name: value.double() for name, value in step.values.items()}
    losses = step.losses(values)
    assert set(losses) == {
        *(
            "radiance",
            "mask",
            "normal",
            "normal_smoothness",
            "albedo",
            "roughness",
            "metallic",
            "pixels",
            "white_balance",
            "light",
            "distortion",
        )
    }
    assert all(float(value) > 0 for value in losses.values())
    assert len(step.plan.pixels) > 10 and len(step.plan.above) > 100


@pytest.mark.parametrize("group", GROUPS)
def test_gradients_of_the_kernels_match_finite_differences_in_float64(step, gradients, group):
    name, rows = GROUPS[group]
    ours = gradients[torch.float32][name]
    chosen = torch.zeros_like(ours, dtype=torch.bool)
    chosen[rows] = True
    ours = torch.where(chosen, ours, 0).double()
    order = ours.abs().flatten().argsort(descending=True)[:ENTRIES]
    single, measured = ours.flatten()[order], []
    for entry in order:
        direction = torch.zeros_like(ours)
        direction.view(-1)[entry] = 1
        measured.append(step.slope(name, direction))
    error = (single - torch.tensor(measured).double()).norm() / single.norm()
    assert error < 1e-3, f"{error:.1e}"
    direction = torch.where(chosen, ours.sign(), 0)  # all at once, so that nothing cancels
    assert float((ours * direction).sum()) == pytest.approx(step.slope(name, direction), rel=1e-3)


def test_gradients_of_both_backends_match_their_references(engine, step, gradients):
    same = Step()  # with a tracer of this backend
    same.plan = step.plan
    ours = same.gradient(torch.float32)
    for group, (name, rows) in GROUPS.items():
        error = (ours[name][rows] - gradients[torch.float64][name][rows]).norm() / gradients[torch.float64][name][rows].norm()
        assert error < 1e-4, f"{group}: {error:.1e}"


def test_traced_rays_alone_bring_gradients_to_the_geometry(step):
    """The pixels' loss with the camera's G-buffer held fixed: what is left comes through visibility and indirect light."""
    values = {name: value.clone().requires_grad_() for name, value in step.values.items()}
    gaussians = Gaussians(**{name: value for name, value in values.items() if name != "light"})
    model = step.models[torch.float32]
    sums = model.render(gaussians, step.view).detach()
    radiance, _ = model.shade(gaussians, values["light"].exp(), sums, step.view, step.plan)
    radiance.sum().backward()
    for name in ("position", "quaternion", "log_scale", "opacity", "sh", "light"):
        assert values[name].grad.abs().sum() > 0, name
    assert values["material"].grad is None
