# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for metal by colour: the albedo that a point would have as metal is compared with that of the metal nearby.

Around a metal part lie points that reflect what their neighbour reflects, such as skin beside a golden belt. As metal they fit about as
well as the metal does, but with another tint. The tints of either material are estimated by kernel densities, so that a metal may have
several. Dark points, such as rubber beside a hub cap, fit as well as dark metal, but bare metals are not dark.
"""

from __future__ import annotations

import torch

from ..metal import DARKEST, TINT_WIDTH, tints

# Added to the mean value of the kernel, so that no tint is impossible; .02 to .04 give about the same.
FLOOR = 0.04
MAX_MEMBERS, BATCH = 2500, 4096  # members with which points are compared, chosen evenly among more, and points at a time
# A point is too dark for metal where its albedo as metal, the mean of the channels, is below DARK_METAL and below DARK_SHARE times that of
# bright metal. In the steps of two solvers on a toy car, 1 per cent of the points of metal had less than .12 to .26, and 90 per cent of the
# black rubber around hub caps less than .15 to .18; on suzanne_mixed and rocker_corner, 1 per cent of the metal had less than .3 and .41.
# An object of dark metal alone keeps it, by DARK_SHARE.
DARK_METAL, DARK_SHARE = 0.16, 0.25
BRIGHT_QUANTILE = 0.9  # quantile of the albedo of metal that counts as that of bright metal


def colour_evidence(as_metal: torch.Tensor, as_dielectric: torch.Tensor, metal: torch.Tensor) -> torch.Tensor:
    """Compute the log of a ratio of densities: of a point's tint as metal among metal, and of its tint as a dielectric among dielectrics.

    A point is not compared with itself.

    Args:
        as_metal: (P, 3) albedo of the points as metal.
        as_dielectric: (P, 3) their albedo as dielectrics.
        metal: (P,) bool, points that count as metal so far.

    Returns:
        (P,), positive where the colour speaks for metal, within +-log(1 / FLOOR + 1).
    """
    return (_density(as_metal, metal) + FLOOR).log() - (_density(as_dielectric, ~metal) + FLOOR).log()


def too_dark(as_metal: torch.Tensor, metal: torch.Tensor) -> torch.Tensor:
    """Find points that would be darker than metals are, see DARK_METAL.

    Args:
        as_metal: (P, 3) albedo of the points as metal.
        metal: (P,) bool, points that count as metal so far, at least one.

    Returns:
        (P,) bool.
    """
    brightness = as_metal.mean(1)
    return brightness < min(DARK_METAL, DARK_SHARE * float(brightness[metal].quantile(BRIGHT_QUANTILE)))


def _density(albedo: torch.Tensor, members: torch.Tensor) -> torch.Tensor:
    """Return the mean (P,) in 0..1 of a kernel of the differences between a point's tint and those of other points, the `members`."""
    tint, chosen = tints(albedo.clamp_min(DARKEST).log()), torch.nonzero(members)[:, 0]
    chosen = chosen[:: max(1, -(-len(chosen) // MAX_MEMBERS))]
    order = torch.arange(len(tint), device=tint.device)
    means = [_kernel_mean(tint[rows], tint[chosen], rows[:, None] == chosen) for rows in order.split(BATCH)]
    return torch.cat(means)


def _kernel_mean(tint: torch.Tensor, members: torch.Tensor, same: torch.Tensor) -> torch.Tensor:
    """Return the mean (B,) of the kernel between tints (B, 2) and members (M, 2), without those that are the `same` point (B, M)."""
    kernel = torch.exp(-0.5 * (torch.cdist(tint, members) / TINT_WIDTH) ** 2).masked_fill(same, 0)
    return kernel.sum(1) / (len(members) - same.sum(1)).clamp_min(1)
