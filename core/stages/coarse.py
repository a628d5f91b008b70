# SPDX-License-Identifier: GPL-3.0-or-later
"""A start of the first stage with few large disks and small pictures, and the way from there to all of them."""

from __future__ import annotations

import math

import torch

from ..config import SkipSettings
from ..datasets.dataset import Dataset
from ..progress import Progress
from ..scene.gaussians import Gaussians
from ..skipping import decide
from .kind import METAL, Kind

SHARE = 0.4  # of the schedule
LENGTH = 0.9  # of a schedule all of which is fine, for the same result
REDUCTION = 2  # pixels along a side that become one
CHILDREN = 4  # of a disk
APART, SHRINK = 0.5, 1.6  # children lie so many standard deviations from the middle, and are so much smaller
SMALLEST = 96  # pixels along the longest side; half of less shows too little


def starts_coarse(dataset: Dataset, kind: Kind, choice: SkipSettings, progress: Progress) -> bool:
    """True where the first stage is to begin coarse: on a hull, since disks on sparse points multiply by what the pictures ask for.

    And where it is metal: reflections set normals right again, while others keep the facets that large disks leave, and albedo suffers.
    """
    if not dataset.has_alpha:
        progress.decided("coarse", False, "without masks disks multiply by themselves")
        return False
    side = max(max(view.camera.width, view.camera.height) for view in dataset.train)
    evidence = f"the object is {kind.name}, pictures are {side} pixels along their longest side"
    return decide(choice, "coarse", kind is METAL and side >= SMALLEST, evidence, progress)


def thinned_out(gaussians: Gaussians, count: int, seed: int) -> Gaussians:
    """At most `count` of the disks, larger so that they cover the same surface."""
    index = torch.randperm(gaussians.count, generator=torch.Generator().manual_seed(seed))[:count]
    few = gaussians.select(index.sort().values)
    few.log_scale += 0.5 * math.log(gaussians.count / few.count)
    return few


def quartered(gaussians: Gaussians) -> Gaussians:
    """Each disk as four smaller ones in its plane, side by side, so that the order in space is kept."""
    children = gaussians.select(torch.arange(gaussians.count).repeat_interleave(CHILDREN))
    sign = gaussians.position.new_tensor([[1.0, 1, -1, -1], [1, -1, 1, -1]]).repeat(1, gaussians.count)
    offset = APART * sign * children.log_scale.exp()
    for tangent, way in zip(children.tangents(), offset, strict=True):
        children.position += tangent * way
    children.log_scale -= math.log(SHRINK)
    return children
