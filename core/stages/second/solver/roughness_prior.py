# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the roughness: what the photographs say about all points of like albedo.

A place that no highlight reached fits nearly as well with any roughness, and noise would choose. The distribution of the roughness over
points of one albedo is estimated from their likelihoods and serves as the prior of each of them (empirical Bayes, Robbins 1956; the
fixed point is that of expectation maximisation). A point with clear evidence keeps its own roughness.

The prior is for a light that has settled. In all searches of the solver it made the light worse: a plant in a pot, light 21.0 -> 17.6 dB,
a pan 14.5 -> 9.6 dB; in the last one alone 21.8 and 15.2 dB. From there on, it is in every search.
"""

from __future__ import annotations

import torch

from .albedo_prior import colour_likeness

INDEPENDENT_ERRORS = 5  # number of independent errors of a point, whose views err alike
MIN_PRIOR = 1e-3  # of the prior: no roughness is impossible
EM_PASSES = 3  # of the expectation maximisation
MAX_SOURCES = 2500  # points, evenly chosen, from which the prior is estimated, at most
BATCH = 10_000  # points compared with the sources at a time


def with_roughness_prior(costs: torch.Tensor, albedo: torch.Tensor) -> torch.Tensor:
    """Add the negative logarithm of the prior to costs.

    Args:
        costs: (P, J) robust errors of P points at J values of the roughness, 0 and more.
        albedo: (P, 3) of the points.

    Returns:
        (P, J) costs with the prior, in the unit of the costs.
    """
    if not len(costs):
        return costs
    # The noise of a point is its least error, or the median of all points' where that is larger. So points whose normals are wrong, which
    # no roughness fits well, count little.
    least = costs.amin(1, keepdim=True)
    scale = (least.clamp_min(least.median()) / INDEPENDENT_ERRORS).clamp_min(1e-12)  # costs / scale: negative log likelihoods
    log_albedo, sources = albedo.clamp_min(0.02).log(), slice(None, None, -(-len(costs) // MAX_SOURCES))
    known, others = (-costs / scale)[sources], log_albedo[sources]
    likeness, posterior = _likeness(others, others), torch.softmax(known, 1)
    for _ in range(EM_PASSES):
        posterior = torch.softmax(known + (likeness @ posterior + MIN_PRIOR).log(), 1)
    prior = torch.cat([_likeness(block, others) @ posterior for block in log_albedo.split(BATCH)])
    return costs - scale * (prior + MIN_PRIOR).log()


def _likeness(log_albedo: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Return the weights (P, S) of others (S, 3) by their likeness to points (P, 3); they sum to 1 over the others."""
    likeness = colour_likeness(log_albedo, others)
    return likeness / likeness.sum(1, keepdim=True)
