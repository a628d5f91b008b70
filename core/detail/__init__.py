# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture detail: albedo from the full-size photographs, with the solved light's shading and gloss taken off."""
