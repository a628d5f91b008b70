# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of the modules of scripts/ under the names that the scripts themselves use."""

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
    """Add scripts/ to the module path within the block, and yield a function that imports a module."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(str(SCRIPTS))


@pytest.fixture(scope="module")
def script() -> Iterator[Callable[[str], ModuleType]]:
    """Return a function that imports a module of scripts/ by its name."""
    with scripts_on_path() as script:
        yield script
