# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfels for tests of ray tracing: a random cloud, and stacks with known hits."""

from __future__ import annotations

import math

import torch

UP = torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]])


def cloud(n, seed, extras=2, size=0.12, opacity=0.0):
    """Return the parameters of n random surfels: position, quaternion, log scale, opacity logit, SH coefficients and extras."""
    g = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    shape = [random(3, n) * 0.6, random(4, n), math.log(size) + random(2, n) * 0.5, random(n) * 1.5 + opacity]
    return [*shape, random(16, 3, n) * 0.3, torch.rand(extras, n, generator=g)]


def rays(count, seed, spread=0.7):
    """Return origins (R, 3) in and around the cloud, many of them inside a surfel's bound, and unit directions (R, 3)."""
    g = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    return torch.randn(count, 3, generator=g) * spread, direction


def stack(n, opacity, gap=1.0):
    """Return n wide surfels perpendicular to +Z at distances gap, 2 gap, ..., shuffled, each with its own value, and their order (n,)."""
    order = torch.randperm(n, generator=torch.Generator().manual_seed(n))
    position = torch.zeros(3, n)
    position[2] = (order + 1) * gap
    quaternion = torch.tensor([1.0, 0, 0, 0])[:, None].repeat(1, n)
    logit = torch.full((n,), math.log(opacity / (1 - opacity)))
    extra = torch.rand(1, n, generator=torch.Generator().manual_seed(1))
    return [position, quaternion, torch.full((2, n), 1.0), logit, None, extra], order
