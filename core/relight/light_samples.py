# SPDX-License-Identifier: GPL-3.0-or-later
"""The samples that the light itself asks for: drawn anew under every light, and traced where something may stand in the way."""

from __future__ import annotations

import numpy as np
import torch

from ..kernels.backend import by_warp
from ..kernels.light_samples import light_range, settle_range
from ..kernels.pool import even_ranges, run_ranges, thread_count
from ..shading.sampling import point_set
from .gathering import Points, Surroundings
from .lighting import PreparedLight
from .openness import BINS, Openness
from .samples import Counts


def add_light_samples(
    sums: torch.Tensor, points: Points, shift: torch.Tensor, counts: Counts, light: PreparedLight, openness: Openness, around: Surroundings
) -> tuple[int, int]:
    """Add to `sums` (P, 2, SUMS) what the last of `counts` samples bring, see `gather`; shift: (P, 2).

    Returns:
        How many of them lie above the horizon, and how many of those were traced.
    """
    n_c, n_g, n_e = counts
    if by_warp(sums):
        return _on_device(sums, points, shift, counts, light, around)
    arrays = [t.contiguous().numpy() for t in (points.view, points.normal, points.alpha, shift, point_set(n_e))]
    table = light.table.numpy()
    clear = [openness.tile.numpy(), openness.clear.numpy(), BINS]
    sample, direction, weights = np.empty((len(shift) * n_e, 3), np.int32), *np.empty((2, len(shift) * n_e, 3), np.float32)
    ranges = even_ranges(len(shift), 4 * thread_count())
    made = np.zeros((len(ranges), 2), np.int64)
    out = (sums.numpy(), sample, direction, weights, made)
    run_ranges(light_range, ranges, *arrays, n_c, n_g, table, light.turn, *clear, *out, numbered=True)
    above, made = int(made[:, 0].sum()), made[:, 1]
    parts = [slice(begin * n_e, begin * n_e + count) for (begin, _), count in zip(ranges, made, strict=True)]
    sample, direction, weights = (np.concatenate([array[part] for part in parts] or [array]) for array in (sample, direction, weights))
    row, met = around.along(points.origin[sample[:, 0].astype(np.int64)], torch.from_numpy(direction))
    ends = np.cumsum(made)
    settled = [(int(end - count), int(end)) for end, count in zip(ends, made, strict=True) if count]
    theirs = [t.contiguous().numpy() for t in (light.table[..., 4:].reshape(-1, 3), light.diffuse[None], light.specular)]
    if settled:
        run_ranges(
            settle_range, settled, sample, weights, row.numpy(), *(t.numpy() for t in met.tensors), *theirs, light.turn, sums.numpy()
        )
    return above, len(sample)


def _on_device(
    sums: torch.Tensor, points: Points, shift: torch.Tensor, counts: Counts, light: PreparedLight, around: Surroundings
) -> tuple[int, int]:
    """The same where every sample is traced."""
    from ..kernels.warp import light as kernels  # an option, not installed everywhere

    n_c, n_g, n_e = counts
    sets = (shift.contiguous(), point_set(n_e).to(shift), n_c, n_g, light.table, light.turn)
    entry, direction, weights = kernels.draw_light(points.view, points.normal, points.alpha, *sets)
    above = torch.nonzero(entry.view(-1) >= 0)[:, 0]
    row = torch.full((entry.numel(),), -1, dtype=torch.int32, device=sums.device)
    row[above], met = around.along(points.origin[above // n_e], direction.view(-1, 3)[above])
    theirs = (light.table, light.diffuse[None].contiguous(), light.specular.contiguous())
    kernels.settle(entry, weights, row.view(-1, n_e), *met.tensors, *theirs, light.turn, sums)
    return len(above), len(above)
