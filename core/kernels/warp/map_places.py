# SPDX-License-Identifier: GPL-3.0-or-later
"""Places of directions in a lat-long map, on the GPU; see core/shading/environment_lookup.py."""

import math

import torch
import warp as wp

from .runtime import launch

_PI, _TURN = wp.constant(math.pi), wp.constant(2 * math.pi)


@wp.func
def place_of(d: wp.vec3) -> wp.vec2:
    """Return u, v of a direction in a lat-long map."""
    return wp.vec2(0.5 - wp.atan2(d[1], d[0]) / _TURN, wp.atan2(wp.sqrt(d[0] * d[0] + d[1] * d[1]), d[2]) / _PI)


@wp.kernel
def places(direction: wp.array(dtype=wp.vec3), out: wp.array2d(dtype=float)):
    """Write u and v of directions (P,) to out (2, P)."""
    p = wp.tid()
    place = place_of(direction[p])
    out[0, p] = place[0]
    out[1, p] = place[1]


def lightmap_places(direction: torch.Tensor) -> torch.Tensor:
    """Return u and v in 0..1, (2, ...), of unit directions (..., 3); without a gradient."""
    flat = direction.detach().contiguous().view(-1, 3)
    out = flat.new_empty(2, len(flat))
    if len(flat):
        launch(places, len(flat), flat, out)
    return out.view(2, *direction.shape[:-1])
