# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine of the reconstruction: images to 2D Gaussians to a mesh with materials. It never imports bpy."""

import os

# Idle threads of the libraries would otherwise spin on the cores that the kernels' threads need. Each is read when its library is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # torch
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")  # numpy and scipy: 2^4 clock cycles; a 4x4 inverse wakes their threads
