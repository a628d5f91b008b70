# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the albedo: few colours (mean shift).

While the light is solved, the albedo is one constant at first, and then pulled to few colours, ever less. Under the solved light, albedos
that fit badly are pulled more: where a normal is wrong, the albedo is wrong, too, and explains no photograph well.
"""

from __future__ import annotations

import math

import torch

# Albedos to start from. From a medium one, the solver does not find the light of a dark glossy object, which is far brighter: it paints the
# reflections on. A black camera's light became 17.6 instead of 7.4 dB.
MEDIUM_ALBEDO, DARK_ALBEDO = 0.5, 0.1
ALBEDO_RANGE = (0.005, 1.5)  # above 1, as the scale of the light is not known yet
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
# Weight of the prior under the solved light. It rises in proportion to the error of a fit, from this quantile of all errors on. With the
# square of the error, and 12 steps, rocker_corner's albedo gained .7 dB, but relit and new views lost .1 and .3 dB.
FIT_WEIGHT, FIT_QUANTILE = 0.1, 0.25
FIT_PASSES = 4  # fixed-point steps to the likely albedo
BATCH = 10_000  # albedos compared with others at a time


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
    if weight is None:
        first, last = RELEASE_WEIGHTS
        weight = first * math.pow(last / first, min(1.0, (done - CONSTANT_STEPS) / RELEASE_STEPS))
    mean, pull = _similar_mean(albedo, _chosen(albedo, generator))
    return mean, weight * pull + 1e-6


def likely_albedo(fit: torch.Tensor, precision: torch.Tensor, error: torch.Tensor, others: torch.Tensor, seed: int) -> torch.Tensor:
    """Pull fitted albedos towards the mean of similar ones, the more the worse they fit.

    Args:
        fit: (N, 3) albedos of least error; they may lie outside the range.
        precision: (N, 3) weight of each, the curvature of half the squared error.
        error: (N,) robust error of a view with it.
        others: (P, 3) known albedos, at least one.
        seed: seed of the random choice of those that are compared.

    Returns:
        (N, 3) in ALBEDO_RANGE.
    """
    albedo, others = fit.clamp(*ALBEDO_RANGE), _chosen(others, torch.Generator().manual_seed(seed))
    small = error.sort().values[int(FIT_QUANTILE * (len(error) - 1))].clamp_min(1e-9)
    weight = FIT_WEIGHT * (error / small).clamp_min(1.0)[:, None]
    for begin in range(0, len(fit), BATCH):
        part = slice(begin, begin + BATCH)
        for _ in range(FIT_PASSES):
            mean, pull = _similar_mean(albedo[part], others)
            pull = weight[part] * pull
            albedo[part] = ((precision[part] * fit[part] + pull * mean) / (precision[part] + pull)).clamp(*ALBEDO_RANGE)
    return albedo


def _chosen(albedo: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Choose COMPARED_POINTS albedos (P, 3) at random, or all where there are fewer."""
    return albedo[torch.randperm(len(albedo), generator=generator)[:COMPARED_POINTS].to(albedo.device)]


def _similar_mean(albedo: torch.Tensor, others: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the geometric mean of the others (S, 3) that are similar to albedos (N, 3), and its weight in a fit, (N, 3) each."""
    log_others = others.log()
    similarity = colour_likeness(_with_less_brightness(albedo.log()), _with_less_brightness(log_others))
    total = similarity.sum(1, keepdim=True)
    return (similarity @ log_others / total).exp(), total / len(others) / albedo.clamp_min(MIN_ALBEDO) ** 2


def colour_likeness(log_albedo: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Return by how much points with log albedos (P, 3) are of the colour of others (S, 3): (P, S), 1 for equal ones."""
    return 1 / (1 + torch.cdist(log_albedo, others).square() / SAME_COLOUR_DIFFERENCE**2) ** 2


def _with_less_brightness(log_albedo: torch.Tensor) -> torch.Tensor:
    """Scale the means over the channels of log albedos (P, 3) so that SAME_TINT_DIFFERENCE becomes SAME_COLOUR_DIFFERENCE."""
    mean = log_albedo.mean(1, keepdim=True)
    return log_albedo - (1 - SAME_COLOUR_DIFFERENCE / SAME_TINT_DIFFERENCE) * mean
