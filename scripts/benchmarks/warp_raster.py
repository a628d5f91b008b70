# SPDX-License-Identifier: GPL-3.0-or-later
"""The rasteriser's forward pass as a warp kernel. For comparison only; warp reads annotations as types, so they must not be strings."""

# pyright: reportMissingImports=false, reportInvalidTypeForm=false, reportAssignmentType=false, reportGeneralTypeIssues=false
# pyright: reportArgumentType=false, reportOperatorIssue=false
# (warp is an option; its kernels are a language of their own)

from functools import cache

import warp as wp

TILE = wp.constant(8)


@cache
def kernel_of(features: int):
    """The kernel for so many feature channels."""
    Sums = wp.types.vector(length=features, dtype=wp.float32)
    channels = wp.constant(features)

    @wp.kernel(module="unique", enable_backward=False)
    def raster(
        start: wp.array(dtype=wp.int64),
        entries: wp.array(dtype=wp.int32),
        record: wp.array2d(dtype=wp.float32),
        feature: wp.array2d(dtype=wp.float32),
        box: wp.array2d(dtype=wp.int32),
        columns: wp.int32,
        picture: wp.array(dtype=wp.float32),
        stride: wp.int32,
        plane: wp.int32,
        low_pass: wp.float32,
        alpha_max: wp.float32,
        stop: wp.float32,
        w_min: wp.float32,
    ):
        y, x = wp.tid()
        tile = (y // TILE) * columns + x // TILE
        sums = Sums()
        depth = wp.float32(0.0)
        left = wp.float32(1.0)
        for entry in range(wp.int32(start[tile]), wp.int32(start[tile + 1])):
            if left <= stop:
                break
            g = entries[entry]
            if y < box[g, 1] or y > box[g, 3]:
                continue
            dx = wp.float32(x) + 0.5 - record[g, 0]
            dy = wp.float32(y) + 0.5 - record[g, 1]
            w = 1.0 + dx * record[g, 6] + dy * record[g, 7]
            iw = wp.float32(1.0)
            disk = wp.float32(1.0e9)
            if w > w_min:
                iw = 1.0 / w
                u = (dx * record[g, 2] + dy * record[g, 3]) * iw
                v = (dx * record[g, 4] + dy * record[g, 5]) * iw
                disk = u * u + v * v
            flat = low_pass * (dx * dx + dy * dy)
            rho = wp.min(disk, flat)
            if rho > record[g, 10]:
                continue
            weight = wp.min(wp.exp(-0.5 * rho) * record[g, 9], alpha_max) * left
            left = left - weight
            for channel in range(channels):
                sums[channel] = sums[channel] + weight * feature[g, channel]
            if disk > flat:  # noqa: SIM108
                depth = depth + weight * record[g, 8]
            else:
                depth = depth + weight * iw * record[g, 8]
        opaque = left <= stop
        scale = wp.float32(1.0)
        if opaque:
            scale = 1.0 / (1.0 - left)
        at = y * stride + x
        for channel in range(channels):
            picture[channel * plane + at] = sums[channel] * scale
        picture[channels * plane + at] = depth * scale
        picture[(channels + 1) * plane + at] = wp.where(opaque, 1.0, 1.0 - left)
        picture[(channels + 2) * plane + at] = left

    return raster
