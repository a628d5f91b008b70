# SPDX-License-Identifier: GPL-3.0-or-later
"""Jacobian of views by the texels of the light, weighted, and its coupling with the albedo of each point, in one pass.

As separate operations on matrices of views by texels it would be limited by memory bandwidth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .cpu.jacobian import jacobian_range

BLOCKS = 4  # of columns of a Gram matrix; with more, little is saved


def jacobian(
    start: Any, root_weight: Any, coupling_weight: Any, factors: tuple[Any, Any], transport: tuple[Any, Any, Any], rows: Any
) -> Any:
    """Compute the weighted derivative of K views by T texels, and its part that the albedo of each of P points can compensate.

    Numpy arrays on the CPU; tensors on a GPU, where memory is fast enough for separate operations. All float32 and contiguous.

    Args:
        start: (P + 1,) int64; the views of point p are start[p] : start[p + 1].
        root_weight: (K,) square root of each view's weight, applied in `rows`.
        coupling_weight: (K,) weight of each view in the result.
        factors: (K,) each, factors of the diffuse and of the specular rows.
        transport: irradiance (P, T), specular rows (K, T), and the part that no albedo scales (K, T); T a multiple of 8.
        rows: (K, T), written: root_weight (factor_0 irradiance + factor_1 specular + rest).

    Returns:
        (P, T) sum over each point's views of the same, with `coupling_weight` in place of `root_weight`.
    """
    if isinstance(rows, torch.Tensor):
        irradiance, scaled, rest = transport
        lengths = start.diff()
        torch.mul(irradiance.repeat_interleave(lengths, 0, output_size=len(rows)), factors[0][:, None], out=rows)
        rows.add_(rest).addcmul_(scaled, factors[1][:, None])
        coupling = torch.segment_reduce(rows * coupling_weight[:, None], "sum", lengths=lengths, axis=0, unsafe=True)
        rows.mul_(root_weight[:, None])
        return coupling
    coupling = np.empty_like(transport[0])
    arrays = (start, root_weight, coupling_weight, *factors, *(t.reshape(-1) for t in transport), rows.reshape(-1), coupling.reshape(-1))
    run_ranges(jacobian_range, even_ranges(len(start) - 1, 4 * thread_count()), rows.shape[1], *arrays)
    return coupling


def gram(rows: torch.Tensor) -> torch.Tensor:
    """Compute the Gram matrix (T, T) of rows (K, T), rows^T rows.

    Only blocks up to the diagonal are multiplied; it is symmetric, but for rounding in the diagonal's blocks on some processors. numpy's
    BLAS has this built in (syrk), but waits busily for its threads: 900 columns took 350 instead of 110 ms with other work on the machine's
    cores, and 60 instead of 54 ms alone.
    """
    count = rows.shape[1]
    product = rows.new_empty(count, count)
    for begin, end in even_ranges(count, BLOCKS):
        product[begin:end, :end] = rows[:, begin:end].T @ rows[:, :end]
        product[:begin, begin:end] = product[begin:end, :begin].T
    return product
