# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighter: the object under any light, by primary G-buffers, secondary rays, multiple importance sampling and denoising."""
