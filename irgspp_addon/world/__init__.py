# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender Worlds as environment maps and back: Worlds that can be read directly, and Worlds that have to be rendered."""
