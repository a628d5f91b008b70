# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet BRDF, lat-long light maps, importance sampling, the rendering equation and split-sum shading."""
