# SPDX-License-Identifier: GPL-3.0-or-later
"""Batches of jobs from a TOML list: their commands, saved states, and workers on this machine or on a Dask cluster."""
