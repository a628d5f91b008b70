# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of traced Gaussians with Cycles' path-traced meshes on a scene of known geometry, materials and light."""
