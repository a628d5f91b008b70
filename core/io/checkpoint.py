# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoint files: nested states of tensors, arrays, numbers and strings, written atomically and checked when read."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .atomic import atomic_file

# torch is imported inside the functions: Blender's process reads run folders without it.


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a state to a file, atomically; its folder is made where it is missing.

    Args:
        path: file that ends with .pt.
        state: nested dicts, lists and tuples of tensors, arrays of any shape (they come back as tensors), numbers and strings.
    """
    import torch

    path.parent.mkdir(exist_ok=True)
    # Given a path, torch doesn't say why it could not be written.
    with atomic_file(path) as partial, partial.open("wb") as file:
        torch.save(_as_tensors(state), file)


def load_checkpoint(path: Path, restored: Callable[[dict[str, Any]], Any] = dict) -> Any:
    """Read a state, its tensors on the CPU, and return `restored(state)`; None where there is no such file.

    Args:
        path: file that `save_checkpoint` wrote.
        restored: makes the returned object of the state; any error that it raises counts as a damaged file.

    Raises:
        InputError: the file is damaged.
    """
    import torch

    if not path.exists():
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > path.stat().st_size:
                raise ValueError("its parts claim to be larger than it is")  # torch compresses nothing
            if archive.testzip() is not None:  # torch reads on where the disk has lost a bit
                raise ValueError("a checksum differs")
        return restored(torch.load(path, map_location="cpu", weights_only=True))
    except MemoryError:
        raise
    except Exception as error:  # a damaged file raises nearly anything
        raise InputError(path, "the checkpoint can't be read", "delete it, or start again with --overwrite") from error


def _as_tensors(value: Any) -> Any:
    """Return the value with tensors in place of arrays and Python numbers in place of NumPy's."""
    import torch

    if isinstance(value, dict):
        return {k: _as_tensors(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_as_tensors(v) for v in value)
    if isinstance(value, np.ndarray):
        return torch.from_numpy(np.ascontiguousarray(value))
    return value.item() if isinstance(value, np.generic) else value
