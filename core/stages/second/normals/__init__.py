# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of the surfels: aligned with the surface, and turned until they explain the shading under the solved light."""
