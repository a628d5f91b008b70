# SPDX-License-Identifier: GPL-3.0-or-later
"""What a process that Mitsuba runs in is asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def received(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The request in a folder and its arrays; Mitsuba's variant and threads are set as it says."""
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    mi.set_variant(request["variant"])
    dr.set_thread_count(request["threads"])
    with np.load(folder / "arrays.npz") as data:
        return request, dict(data)
