# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of scripts/reimport.py: reading a file in a fresh Blender, and comparing what was read."""
