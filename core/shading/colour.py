# SPDX-License-Identifier: GPL-3.0-or-later
"""The sRGB curve, as shading knows it; it lives below, where the dataset readers can reach it too."""

from ..colour import decode_srgb, encode_srgb, luminance

__all__ = ["decode_srgb", "encode_srgb", "luminance"]
