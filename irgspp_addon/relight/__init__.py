# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting inside Blender: worker sessions, live images that follow the scene, the render engine, and reference views by Cycles."""
