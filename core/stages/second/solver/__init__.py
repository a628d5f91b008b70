# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed solver: light and materials of points of the surface by variable projection, and then of the Gaussians around them."""
