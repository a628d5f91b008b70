# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension and its modules."""

from __future__ import annotations

import sys
from types import ModuleType

MODULE = "bl_ext.user_default.irgspp"  # name of the installed extension


def extension_module(name: str) -> ModuleType:
    """Return a loaded module of the extension by its name below the extension, such as `irgspp_addon.jobs.queue`."""
    return sys.modules[f"{MODULE}.{name}"]
