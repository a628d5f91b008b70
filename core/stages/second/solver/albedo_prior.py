# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the albedo while the light is solved: one constant at first, then few colours (mean shift), ever less."""

from __future__ import annotations

import torch

CONSTANT = 3  # steps with one albedo for all points
RELEASE = 12  # steps over which the weight of the prior falls
PRIOR = (1.0, 0.03)  # first and last weight
COLOURS = 0.15  # difference in log albedo below which two points count as being of one colour
SAMPLE = 1000  # points that each point's colour is compared with


def albedo_prior(albedo: torch.Tensor, done: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Return target and weight of the prior: the mean of similar albedos.

    Args:
        albedo: (P, 3) current values.
        done: steps of the solver that are done.
        generator: of the points that colours are compared with.

    Returns:
        (P, 3) each.
    """
    if done < CONSTANT:
        return torch.full_like(albedo, 0.5), torch.full_like(albedo, 1e3)
    log_albedo = albedo.log()
    others = log_albedo[torch.randperm(len(log_albedo), generator=generator)[:SAMPLE].to(log_albedo.device)]
    similarity = 1 / (1 + torch.cdist(log_albedo, others).square() / COLOURS**2) ** 2
    total = similarity.sum(1, keepdim=True)
    strength = PRIOR[0] * (PRIOR[1] / PRIOR[0]) ** min(1.0, (done - CONSTANT) / RELEASE)
    pull = strength * total / len(others) / albedo.clamp_min(0.02) ** 2 + 1e-6
    return (similarity @ others / total).exp(), pull
