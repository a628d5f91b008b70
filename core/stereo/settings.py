# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of multi-view stereo."""

from __future__ import annotations

from dataclasses import dataclass

MOST_SOURCES = 31  # the kernels hold a set of sources in the bits of an int32


@dataclass(frozen=True)
class StereoSettings:
    """Settings of depth estimation and of the agreement between depth maps.

    Attributes:
        sources: number of views that each view is matched with.
        best: number of them, those with the lowest costs, that the cost of a pixel averages: a point is hidden in some.
        coarse_sweeps: passes over the images at half resolution.
        fine_sweeps: passes at full resolution.
        geometric_sweeps: passes that also compare with the sources' depth maps.
        geometric_penalty: cost of one pixel of reprojection error in these passes.
        brightness: largest cost of patches without texture that are not equally bright: shading alone looks alike at many depths. 0 where
            exposure or light differ from view to view.
        sigma: standard deviation of the bilateral weights, in grey values of 0..1.
        largest_cost: 1 - NCC above which a pixel has no support.
        reprojection: error in pixels, there and back, up to which two depths agree.
        relative_depth: difference of depths, as a fraction, up to which they agree.
        cosine: cosine of the angle between normals from which they agree.
        witnesses: largest number of views that a view's depths are compared with.

    Raises:
        ValueError: a number of sources is out of range.
    """

    sources: int = 8
    best: int = 2
    coarse_sweeps: int = 5
    fine_sweeps: int = 2
    geometric_sweeps: int = 1
    geometric_penalty: float = 0.12
    brightness: float = 0.3
    sigma: float = 0.08
    largest_cost: float = 0.45
    reprojection: float = 1.5
    relative_depth: float = 0.01
    cosine: float = 0.5
    witnesses: int = 16

    def __post_init__(self) -> None:
        if not 1 <= self.best <= self.sources <= MOST_SOURCES:
            raise ValueError(f"stereo with {self.best} best of {self.sources} sources; give 1 <= best <= sources <= {MOST_SOURCES}")
