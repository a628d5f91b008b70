# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a module, imported before any test."""

import blender_side  # noqa: F401
