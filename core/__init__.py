# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine of the reconstruction: images to 2D Gaussians to a mesh with materials. It never imports bpy."""

import os

# Read when torch is loaded: else its idle threads spin on the cores that the kernels' threads need.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
