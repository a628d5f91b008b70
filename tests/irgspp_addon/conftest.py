# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a module, and a finished run."""

from blender_side import run_folder  # noqa: F401
