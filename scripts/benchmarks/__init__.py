# SPDX-License-Identifier: GPL-3.0-or-later
"""Sections of the benchmark, one module each, their shared parts, and the report."""
