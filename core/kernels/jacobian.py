# SPDX-License-Identifier: GPL-3.0-or-later
"""How each view depends on each texel of the light, weighted, and how much of that its point's albedo can take up, in one pass.

As separate operations on matrices of views by texels, memory is the limit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .cpu.jacobian import jacobian_range


def jacobian(start: Any, root: Any, share: Any, factors: tuple[Any, Any], transport: tuple[Any, Any, Any], rows: Any) -> Any:
    """The weighted derivative of K views by T texels, and its part that the albedo of each of P points can take up.

    Numpy's arrays on the CPU, tensors on a device, where memory is quick enough for separate operations.

    Args:
        start: (P + 1,) int64, point p's views are start[p] : start[p + 1]. root, share: (K,) weight of a view in `rows` and in the result.
        factors: (K,) each, of the diffuse and the specular rows. transport: irradiance (P, T), specular rows (K, T), and those that
            no albedo scales (K, T); T a multiple of 8. All float32 and contiguous.
        rows: (K, T), written: root (factor_0 irradiance + factor_1 specular + rest).

    Returns:
        (P, T): the sum over a point's views of the same, with `share` for `root`.
    """
    if isinstance(rows, torch.Tensor):
        irradiance, scaled, rest = transport
        lengths = start.diff()
        torch.mul(irradiance.repeat_interleave(lengths, 0, output_size=len(rows)), factors[0][:, None], out=rows)
        rows.add_(rest).addcmul_(scaled, factors[1][:, None])
        coupling = torch.segment_reduce(rows * share[:, None], "sum", lengths=lengths, axis=0, unsafe=True)
        rows.mul_(root[:, None])
        return coupling
    coupling = np.empty_like(transport[0])
    arrays = (start, root, share, *factors, *(t.reshape(-1) for t in transport), rows.reshape(-1), coupling.reshape(-1))
    run_ranges(jacobian_range, even_ranges(len(start) - 1, 4 * thread_count()), rows.shape[1], *arrays)
    return coupling
