# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks for rays: a cloud of random ones, and stacks whose hits are known."""

from __future__ import annotations

import math

import torch

UP = torch.zeros(1, 3), torch.tensor([[0.0, 0.0, 1.0]])


def cloud(n, seed, extras=2, size=0.12, opacity=0.0):
    g = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    shape = [random(3, n) * 0.6, random(4, n), math.log(size) + random(2, n) * 0.5, random(n) * 1.5 + opacity]
    return [*shape, random(16, 3, n) * 0.3, torch.rand(extras, n, generator=g)]


def rays(count, seed, spread=0.7):
    """Origins in and around the cloud, so that many lie inside a surfel's bound."""
    g = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    return torch.randn(count, 3, generator=g) * spread, direction


def stack(n, opacity, gap=1.0):
    """n wide surfels square across +Z, at gap, 2 gap, ..., shuffled, each of its own value; returns them with their order."""
    order = torch.randperm(n, generator=torch.Generator().manual_seed(n))
    position = torch.zeros(3, n)
    position[2] = (order + 1) * gap
    quaternion = torch.tensor([1.0, 0, 0, 0])[:, None].repeat(1, n)
    logit = torch.full((n,), math.log(opacity / (1 - opacity)))
    extra = torch.rand(1, n, generator=torch.Generator().manual_seed(1))
    return [position, quaternion, torch.full((2, n), 1.0), logit, None, extra], order
