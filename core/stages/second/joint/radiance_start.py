# SPDX-License-Identifier: GPL-3.0-or-later
"""Start of the joint optimisation: SH that hold all radiance, as its secondary rays expect.

The first stage's SH of a glossy object hold the diffuse part, to which reflections are added. Ref-Gaussian's are taken over by IRGS as
they are and converge in some hundred iterations, during which the indirect light is wrong; here they are fitted beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ....errors import Cancelled
from ....io.srgb import decode_srgb
from ....kernels.rasterize import EXTRA, rasterize
from ....progress.protocol import Progress
from ....scene.dataset import View
from ....scene.gaussians import Gaussians
from ....scene.reconstruction import Reconstruction
from ....scene.spherical_harmonics import SH_C0
from ....settings.schema import Settings
from ...common.training_view import TrainingView, make_training_view
from ..radiance_refit import refit_radiance

WARM_UP_ITERATIONS = 300  # iterations of the fit of the SH
MIN_MASK_OPACITY = 0.99  # of the mask: pixels that show the object alone
MIN_SEEN_WEIGHT = 1e-3  # summed weight in pixels from which a surfel has been seen


def with_all_radiance(start: Reconstruction, views: Sequence[View], settings: Settings, progress: Progress) -> Reconstruction:
    """Return a reconstruction whose SH hold all radiance.

    Args:
        start: reconstruction, with split-sum reflections or without.
        views: photographs.
        settings: settings of the job.
        progress: receives the progress and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    if not start.has_split_sum:
        return start
    g = start.gaussians
    mean, seen = mean_seen_radiance(g, [make_training_view(view, crop=view.alpha is not None) for view in views], start.bound.radius)
    sh = torch.zeros_like(g.sh)
    sh[0] = torch.where(seen, (mean - 0.5) / SH_C0, g.sh[0])
    plain = replace(start, gaussians=replace(g, sh=sh), has_split_sum=False, reflections=None)
    progress.phase("radiance", WARM_UP_ITERATIONS)

    def report(done: int) -> bool:
        """Report an iteration; return True to finish early."""
        progress.step(done)
        if progress.cancelled:
            raise Cancelled("stopped before the joint optimisation")
        return progress.finish_early

    return refit_radiance(plain, views, WARM_UP_ITERATIONS, settings.seed, on_step=report, subpixels=settings.first.subpixels)


def mean_seen_radiance(gaussians: Gaussians, views: Sequence[TrainingView], scene_radius: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the mean linear radiance (3, N) of the pixels that show each surfel, by its weights there, and which are seen, (N,) bool.

    The sum of weight x colour over pixels is the gradient of a rasterised channel.

    Args:
        gaussians: N surfels.
        views: photographs.
        scene_radius: world units.
    """
    g = Gaussians(**{name: value.detach() for name, value in gaussians.tensors().items()})
    extra = g.position.new_zeros(4, g.count).requires_grad_()
    for view in (one.to(g.position.device) for one in views):
        sums, _ = rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, view.camera, scene_radius)
        shown = sums[-1].detach() > MIN_MASK_OPACITY
        if view.alpha is not None:
            shown = shown & (view.alpha > MIN_MASK_OPACITY)
        target = torch.cat([decode_srgb(view.image), torch.ones_like(view.image[:1])]) * shown
        (sums[EXTRA : EXTRA + 4] * target).sum().backward()
    total = extra.grad if extra.grad is not None else torch.zeros_like(extra)
    return total[:3] / total[3].clamp_min(MIN_SEEN_WEIGHT), total[3] > MIN_SEEN_WEIGHT
