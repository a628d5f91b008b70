# SPDX-License-Identifier: GPL-3.0-or-later
"""Light on the vertices of a mesh along rays traced once.

Called by core/relight/vertex_transfer.py, whose `arriving` is the reference.
"""

from __future__ import annotations

from .jit import kernel


@kernel
def visible_light_range(begin, end, texel, vertex, grid, unoccluded, out):
    """Write to `out` (V, 3), for vertices begin..end, the part of the `unoccluded` light (V, 3) that their rays find visible.

    texel: (V, M) rows of `grid` (T, 3), the light in the directions of the rays. vertex: (V, M) vertices that the rays hit, -1 for none;
    rays with hits come first.
    """
    count = texel.shape[1]
    for p in range(begin, end):
        for c in range(3):
            hidden, visible = 0.0, 0.0
            i = 0
            while i < count and vertex[p, i] >= 0:
                hidden += grid[texel[p, i], c]
                i += 1
            while i < count:
                visible += grid[texel[p, i], c]
                i += 1
            total = hidden + visible
            out[p, c] = unoccluded[p, c] * (visible / total) if total > 0 else 0.0


@kernel
def bounce_range(begin, end, vertex, visible, reflected, out):
    """Write to `out` (V, 3), for vertices begin..end, `visible` light (V, 3) plus the mean over their rays of what hit vertices reflect.

    vertex: (V, M) as in `visible_light_range`. reflected: (V + 1, 3) radiance of each vertex; the last is the inside of the object.
    """
    count = vertex.shape[1]
    for p in range(begin, end):
        red, green, blue = 0.0, 0.0, 0.0
        i = 0
        while i < count and vertex[p, i] >= 0:
            k = vertex[p, i]
            red += reflected[k, 0]
            green += reflected[k, 1]
            blue += reflected[k, 2]
            i += 1
        out[p, 0] = visible[p, 0] + red / count
        out[p, 1] = visible[p, 1] + green / count
        out[p, 2] = visible[p, 2] + blue / count
