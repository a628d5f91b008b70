# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the albedo while the light is solved: one constant at first, then few colours (mean shift), ever less."""

from __future__ import annotations

import torch

# Albedos to start from. From a medium one, the solver does not find the light of a dark glossy object, which is far brighter: it paints the
# reflections on. A black camera's light became 17.6 instead of 7.4 dB.
MEDIUM_ALBEDO, DARK_ALBEDO = 0.5, 0.1
CONSTANT_STEPS = 3  # first steps, with one albedo for all points
RELEASE_STEPS = 12  # steps over which the weight of the prior falls
RELEASE_WEIGHTS = (1.0, 0.03)  # first and last weight after these
# Weight while light and roughness settle: the albedo is fitted again afterwards, and the light gains (rocker_corner 14.2 dB, and 13.3 with
# the last weight above).
SETTLING_WEIGHT = 0.1
CONSTANT_WEIGHT = 1e3  # weight in the first steps, far above that of a point's samples
MIN_ALBEDO = 0.02  # least albedo by which the weight is divided
SAME_COLOUR_DIFFERENCE = 0.15  # difference in log albedo below which two points count as being of one colour
# Difference in mean log albedo below which two points of equal tint do. Where only dim light arrives, such as under a plate, brighter light
# on a darker surface looks the same but for gloss; the same paint elsewhere tells them apart.
SAME_TINT_DIFFERENCE = 0.45
COMPARED_POINTS = 1000  # points that each point's colour is compared with


def albedo_prior(
    albedo: torch.Tensor, done: int, start: float, generator: torch.Generator, weight: float | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return target and weight of the prior: the mean of similar albedos.

    Args:
        albedo: (P, 3) current values.
        done: steps of the solver that are done.
        start: albedo of all points while it is constant.
        generator: random generator that selects the points that colours are compared with.
        weight: of the prior, once the albedo is not constant; None: by the number of steps.

    Returns:
        (P, 3) each.
    """
    if done < CONSTANT_STEPS:
        return torch.full_like(albedo, start), torch.full_like(albedo, CONSTANT_WEIGHT)
    log_albedo = albedo.log()
    others = log_albedo[torch.randperm(len(log_albedo), generator=generator)[:COMPARED_POINTS].to(log_albedo.device)]
    similarity = colour_likeness(_with_less_brightness(log_albedo), _with_less_brightness(others))
    total = similarity.sum(1, keepdim=True)
    if weight is None:
        weight = RELEASE_WEIGHTS[0] * (RELEASE_WEIGHTS[1] / RELEASE_WEIGHTS[0]) ** min(1.0, (done - CONSTANT_STEPS) / RELEASE_STEPS)
    pull = weight * total / len(others) / albedo.clamp_min(MIN_ALBEDO) ** 2 + 1e-6
    return (similarity @ others / total).exp(), pull


def colour_likeness(log_albedo: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Return by how much points with log albedos (P, 3) are of the colour of others (S, 3): (P, S), 1 for equal ones."""
    return 1 / (1 + torch.cdist(log_albedo, others).square() / SAME_COLOUR_DIFFERENCE**2) ** 2


def _with_less_brightness(log_albedo: torch.Tensor) -> torch.Tensor:
    """Scale the means over the channels of log albedos (P, 3) so that SAME_TINT_DIFFERENCE becomes SAME_COLOUR_DIFFERENCE."""
    mean = log_albedo.mean(1, keepdim=True)
    return log_albedo - (1 - SAME_COLOUR_DIFFERENCE / SAME_TINT_DIFFERENCE) * mean
