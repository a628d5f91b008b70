# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of a job: their schema, presets, overrides from the command line, and names of earlier versions."""
