# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of numbers in an .npz that may come from anywhere: no more memory is taken than they have values for."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np

from ..errors import InputError

LARGEST = 128 << 20  # bytes of one array
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_arrays(path: Path, *names: str) -> list[np.ndarray]:
    """The arrays of these names, not to be written to. Raises InputError where the file is missing or broken, or one is not in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            most = path.stat().st_size
            if any(entry.compress_size > most for entry in archive.infolist()):  # zipfile would make room for it
                raise ValueError("a part claims to be larger than the whole")
            return [_array(archive, f"{name}.npy") for name in names]
    except Exception as error:  # damaged archives raise nearly anything
        raise InputError(path, f"the arrays can't be read ({type(error).__name__}: {error})") from error


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """What np.load gives, but for its making room for all that a header claims before it looks how much there is."""
    if archive.getinfo(name).file_size > LARGEST:
        raise ValueError(f"{name} is too large")
    data = archive.read(name)
    file = io.BytesIO(data)
    shape, columns_first, kind = HEADERS[np.lib.format.read_magic(file)](file)
    values = np.frombuffer(data, kind, math.prod(shape), file.tell())
    return values.reshape(shape, order="F" if columns_first else "C")
