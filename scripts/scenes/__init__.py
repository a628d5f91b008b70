# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scenes of rendered datasets, and their ground truth by Cycles."""
