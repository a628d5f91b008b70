# SPDX-License-Identifier: GPL-3.0-or-later
"""Folder that all processes of one test run share."""

from __future__ import annotations

from pathlib import Path

import pytest


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the temporary folder of the whole test run; of several processes, each has its own folder in it."""
    base = factory.getbasetemp()
    return base.parent if base.name.startswith("popen") else base
