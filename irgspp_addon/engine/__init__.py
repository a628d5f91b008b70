# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's Python environment: installing it, checking it, and starting its processes."""
