# SPDX-License-Identifier: GPL-3.0-or-later
"""The samples that the light itself asks for: drawn anew under every light, and traced where something may stand in the way."""

from __future__ import annotations

import numpy as np
import torch

from ..kernels.cpu.light_samples import light_range, settle_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..shading.sampling import point_set
from .indirect_light import Points
from .prepared_light import PreparedLight
from .sample_counts import Counts
from .secondary_query import SurfaceQuery
from .visibility_cache import BINS, VisibilityCache


def add_light_samples(
    sums: torch.Tensor,
    points: Points,
    shift: torch.Tensor,
    counts: Counts,
    light: PreparedLight,
    visibility_cache: VisibilityCache,
    query: SurfaceQuery,
) -> tuple[int, int]:
    """Add to `sums` (P, 2, SUMS) what the last of `counts` samples bring of the light itself, see `gather`; shift: (P, 2).

    Returns:
        How many of them lie above the horizon, and how many of those were traced.
    """
    n_c, n_g, n_e = counts
    if by_warp(sums):
        return _on_device(sums, points, shift, counts, light, query)
    arrays = [t.contiguous().numpy() for t in (points.view, points.normal, points.alpha, shift, point_set(n_e))]
    table = light.table.numpy()
    clear = [visibility_cache.tile.numpy(), visibility_cache.clear.numpy(), BINS]
    sample, direction, weights = np.empty((len(shift) * n_e, 3), np.int32), *np.empty((2, len(shift) * n_e, 3), np.float32)
    ranges = even_ranges(len(shift), 4 * thread_count())
    made = np.zeros((len(ranges), 2), np.int64)
    out = (sums.numpy(), sample, direction, weights, made)
    run_ranges(light_range, ranges, *arrays, n_c, n_g, table, light.turn, *clear, *out, numbered=True)
    above, made = int(made[:, 0].sum()), made[:, 1]
    parts = [slice(begin * n_e, begin * n_e + count) for (begin, _), count in zip(ranges, made, strict=True)]
    sample, direction, weights = (np.concatenate([array[part] for part in parts] or [array]) for array in (sample, direction, weights))
    hidden = query.hidden(points.origin[sample[:, 0].astype(np.int64)], torch.from_numpy(direction))
    ends = np.cumsum(made)
    settled = [(int(end - count), int(end)) for end, count in zip(ends, made, strict=True) if count]
    if settled:
        radiance = light.table[..., 4:].reshape(-1, 3).contiguous().numpy()
        run_ranges(settle_range, settled, sample, weights, hidden.numpy(), radiance, sums.numpy())
    return above, len(sample)


def _on_device(
    sums: torch.Tensor, points: Points, shift: torch.Tensor, counts: Counts, light: PreparedLight, query: SurfaceQuery
) -> tuple[int, int]:
    """The same where every sample is traced."""
    from ..kernels.warp import light as kernels  # an option, not installed everywhere

    n_c, n_g, n_e = counts
    sets = (shift.contiguous(), point_set(n_e).to(shift), n_c, n_g, light.table, light.turn)
    entry, direction, weights = kernels.draw_light(points.view, points.normal, points.alpha, *sets)
    above = torch.nonzero(entry.view(-1) >= 0)[:, 0]
    hidden = torch.zeros(entry.shape, device=sums.device)
    hidden.view(-1)[above] = query.hidden(points.origin[above // n_e], direction.view(-1, 3)[above])
    kernels.settle(entry, weights, hidden, light.table, sums)
    return len(above), len(above)
