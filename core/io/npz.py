# SPDX-License-Identifier: GPL-3.0-or-later
"""Safe reading of numeric arrays from untrusted .npz files: no more memory is allocated than the file has values for."""

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
    """Read arrays by their names; they are read-only.

    Args:
        path: the .npz.
        names: names of the arrays, in the order of the result.

    Raises:
        InputError: if the file is missing or broken, or lacks one of the arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            most = path.stat().st_size
            if any(entry.compress_size > most for entry in archive.infolist()):  # zipfile would allocate memory for it
                raise ValueError("a part claims to be larger than the whole")
            return [_array(archive, f"{name}.npy") for name in names]
    except Exception as error:  # damaged archives raise nearly anything
        raise InputError(path, f"the arrays can't be read ({type(error).__name__}: {error})") from error


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Read an array as np.load does, which however allocates all that the header claims before it checks how much there is."""
    if archive.getinfo(name).file_size > LARGEST:
        raise ValueError(f"{name} is too large")
    data = archive.read(name)
    file = io.BytesIO(data)
    shape, columns_first, dtype = HEADERS[np.lib.format.read_magic(file)](file)
    values = np.frombuffer(data, dtype, math.prod(shape), file.tell())
    return values.reshape(shape, order="F" if columns_first else "C")
