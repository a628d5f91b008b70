# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender side of the extension: registration, scene properties, preferences, and the packages that run the engine and import results."""
