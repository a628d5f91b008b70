# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a module, before any test imports it."""

import blender_side  # noqa: F401
