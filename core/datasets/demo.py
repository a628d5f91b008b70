# SPDX-License-Identifier: GPL-3.0-or-later
"""Demo dataset that comes with the package, and the settings that fit it."""

from pathlib import Path

DEMO_DATA = Path(__file__).parents[1] / "demo_data"
# As much detail as its 64x64 images can carry.
DEMO_OVERRIDES = ("first.gaussians=10000", "surface.voxels=96", "surface.triangles=10000", "surface.texture=512")
