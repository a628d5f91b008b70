# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's sections, one module each, what they share, and the report."""
