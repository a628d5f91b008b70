# SPDX-License-Identifier: GPL-3.0-or-later
"""Versions of everything that a result depends on."""

from __future__ import annotations

import platform
from contextlib import suppress
from importlib import metadata


def versions() -> dict[str, str]:
    """Return the versions of everything that the result depends on, without packages that are not installed."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for name in ("irgspp", "torch", "numba", "numpy", "scipy", "scikit-image", "xatlas", "embreex", "bpy", "warp-lang"):
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
