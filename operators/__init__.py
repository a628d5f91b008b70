# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the extension: what its buttons and menus do, and what scripts call as `bpy.ops.irgspp.*`."""
