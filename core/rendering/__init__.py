# SPDX-License-Identifier: GPL-3.0-or-later
"""Deferred rendering of 2D Gaussians: G-buffers of cameras, split-sum reflections, and secondary rays of the reconstruction."""
