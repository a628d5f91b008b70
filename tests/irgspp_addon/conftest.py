# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare Blender as a module before any test imports it."""

import blender_side  # noqa: F401
