# SPDX-License-Identifier: GPL-3.0-or-later
"""Light-map samples of relighting: drawn for every light, and traced where something may occlude them.

They are the strategy N_e of the mixture (`core/shading/sampling.py`), drawn from the table of `PreparedLight`.
"""

from __future__ import annotations

import numpy as np
import torch

from ..kernels.cpu.light_samples import light_range, settle_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..shading.sampling import point_set, points_on
from .indirect_light import ShadingPoints
from .prepared_light import PreparedLight
from .sample_counts import SampleCounts
from .secondary_query import SurfaceQuery
from .visibility_cache import BINS, VisibilityCache


def add_light_samples(
    sums: torch.Tensor,
    points: ShadingPoints,
    shift: torch.Tensor,
    counts: SampleCounts,
    light: PreparedLight,
    visibility_cache: VisibilityCache,
    query: SurfaceQuery,
) -> tuple[int, int]:
    """Add the contribution of the light-map samples, the last of `counts`, to the sums of `gather`.

    Occluded samples count in the unoccluded sum alone: the light that occluders reflect comes from the other samples.

    Args:
        sums: (P, 2, SUMS) sums, changed in place.
        points: the P points.
        shift: (P, 2) shift of each point's samples on the torus, in [0, 1).
        counts: samples of each strategy.
        light: the light, possibly rotated.
        visibility_cache: directions in which no ray has to be traced.
        query: scene for shadow rays.

    Returns:
        Numbers of samples above the horizon and of samples traced.
    """
    n_c, n_g, n_e = counts
    if by_warp(sums):
        return _on_device(sums, points, shift, counts, light, query)
    given = (points.view, points.normal, points.origin, points.alpha, shift, point_set(n_e))
    arrays = [t.contiguous().numpy() for t in given]
    table = light.table.numpy()
    unoccluded = [visibility_cache.tile.numpy(), visibility_cache.clear.numpy(), BINS]
    sample, (weights, *rays) = np.empty((len(shift) * n_e, 3), np.int32), np.empty((3, len(shift) * n_e, 3), np.float32)
    ranges = even_ranges(len(shift), 4 * thread_count())
    counted = np.zeros((len(ranges), 2), np.int64)
    out = (points.brdf == "irgs", sums.numpy(), sample, *rays, weights, counted)

    def add(number: int, begin: int, end: int) -> None:
        light_range(number, begin, end, *arrays, n_c, n_g, table, light.turn, *unoccluded, *out)
        first, last = begin * n_e, begin * n_e + int(counted[number, 1])
        if last > first:
            hidden = query.hidden(*(torch.from_numpy(part[first:last]) for part in rays))
            settle_range(first, last, sample, weights, hidden.numpy(), table, sums.numpy())

    run_ranges(add, ranges, numbered=True)
    above, traced = counted.sum(0).tolist()
    return above, traced


def _on_device(
    sums: torch.Tensor, points: ShadingPoints, shift: torch.Tensor, counts: SampleCounts, light: PreparedLight, query: SurfaceQuery
) -> tuple[int, int]:
    """Do the same by Warp kernels, tracing every sample above the horizon."""
    from ..kernels.warp import light as kernels  # an optional dependency

    n_c, n_g, n_e = counts
    sets = (shift.contiguous(), points_on(n_e, shift.dtype, shift.device), n_c, n_g, light.table, light.turn, points.brdf == "irgs")
    entry, direction, weights = kernels.draw_light(points.view, points.normal, points.alpha, *sets)
    above = torch.nonzero(entry.view(-1) >= 0)[:, 0]
    hidden = torch.zeros(entry.shape, device=sums.device)
    hidden.view(-1)[above] = query.hidden(points.origin[above // n_e], direction.view(-1, 3)[above])
    kernels.settle(entry, weights, hidden, light.table, sums)
    return len(above), len(above)
