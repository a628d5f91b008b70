# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of the requests to a process that Mitsuba runs in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def read_request(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read request.json and arrays.npz of a folder, and set Mitsuba's variant and number of threads as the request says."""
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    mi.set_variant(request["variant"])
    dr.set_thread_count(request["threads"])
    with np.load(folder / "arrays.npz") as data:
        return request, dict(data)
