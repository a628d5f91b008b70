# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of the numerical stress test, one module for each group; importing a module registers its cases."""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch, as the engine does: idle threads must not occupy the cores of busy ones
