# SPDX-License-Identifier: GPL-3.0-or-later
"""IRGS++ for Blender: photographs in, a relightable Blender object out."""
