# SPDX-License-Identifier: GPL-3.0-or-later
"""File access: images, OpenEXR, the sRGB curve, arrays, atomic writing, file locks, and safe reading of untrusted files."""
