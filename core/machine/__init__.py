# SPDX-License-Identifier: GPL-3.0-or-later
"""Machine that a job runs on: devices, CUDA, threads, memory, disk space, cache folders and child processes."""
