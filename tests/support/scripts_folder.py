# SPDX-License-Identifier: GPL-3.0-or-later
"""The modules of scripts/, imported as the scripts themselves see them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@contextmanager
def scripts_on_path() -> Iterator[Callable[[str], ModuleType]]:
    """Within the block they go by their own names; what imports one."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(str(SCRIPTS))


@pytest.fixture(scope="module")
def script() -> Iterator[Callable[[str], ModuleType]]:
    """A module of them by its name."""
    with scripts_on_path() as script:
        yield script
