# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of the object with a photograph, seen through the photograph's camera."""
