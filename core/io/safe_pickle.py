# SPDX-License-Identifier: GPL-3.0-or-later
"""Safe reading of pickled numpy arrays from untrusted files, without running any code that they name."""

from __future__ import annotations

import io
import pickle
import pickletools
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError

LARGEST = 64 << 20  # bytes; cameras of thousands of images take less
VALUES = 200_000  # largest number of values in a pickle, each counted as often as it is referenced
OPERATIONS = 10 * VALUES
NUMBERS = re.compile(r"[biufU]\d+")


def read_pickle(path: Path) -> Any:
    """Read a pickle of numpy arrays, numbers, strings, lists, tuples and dictionaries.

    Nothing that the file names is ever called: even the arrays are built here.

    Raises:
        InputError: if the file is damaged, too large, or holds anything else.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(path, f"is a pickle of more than {LARGEST >> 20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    try:
        _check_operations(data)
        return _Finish()(_Arrays(io.BytesIO(data)).load())
    except pickle.UnpicklingError as error:
        raise InputError(path, f"is refused: {error}", "a pickle of plain numpy arrays is expected") from error
    except Exception as error:  # a damaged pickle raises nearly anything
        raise InputError(path, f"not a readable pickle ({type(error).__name__})") from error


def _check_operations(data: bytes) -> None:
    """Raise UnpicklingError if an operation would allocate more memory than the file can fill, or if there are too many operations."""
    for number, (operation, argument, _) in enumerate(pickletools.genops(data)):
        if "PUT" in operation.name and isinstance(argument, int) and argument > len(data):
            raise pickle.UnpicklingError(f"it gives a value the number {argument}")
        if number > OPERATIONS:
            raise pickle.UnpicklingError(f"it has more than {OPERATIONS} operations")


class _Dtype:
    """Stand-in for numpy.dtype."""

    def __init__(self, code: str, *_: object) -> None:
        if not isinstance(code, str) or not NUMBERS.fullmatch(code):
            raise pickle.UnpicklingError(f"it has an array of {str(code)[:20]!r}")
        self.code, self.order = code, "="

    def __setstate__(self, state: tuple) -> None:
        self.order = state[1] if state[1] in ("<", ">") else "="

    def numpy(self) -> np.dtype:
        return np.dtype(self.order + self.code)


class _Array:
    """Stand-in for numpy.ndarray: stores its pickled state, and is replaced by an array once the whole pickle is read."""

    value: np.ndarray | None = None

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        self.value = _array(data, dtype, shape, "F" if fortran else "C")


def _array(data: bytes, dtype: _Dtype, shape: tuple, order: str) -> np.ndarray:
    return np.frombuffer(data, dtype.numpy()).reshape(shape, order="F" if order == "F" else "C").copy()


def _reconstruct(*_: object) -> _Array:
    return _Array()


def _from_buffer(data: bytes, dtype: _Dtype, shape: tuple, order: str) -> np.ndarray:
    return _array(bytes(data), dtype, shape, order)


def _scalar(dtype: _Dtype, data: bytes) -> Any:
    return _array(data, dtype, (), "C").item()


def _latin(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it names the encoding {str(encoding)[:20]!r}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    return b""


KNOWN = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Dtype,
    ("_codecs", "encode"): _latin,  # bytes, in pickles of Python 2's protocols
    ("__builtin__", "bytes"): _no_bytes,  # where they are empty
}
for _core in ("numpy.core", "numpy._core"):
    KNOWN[_core + ".multiarray", "_reconstruct"] = _reconstruct
    KNOWN[_core + ".multiarray", "scalar"] = _scalar
    KNOWN[_core + ".numeric", "_frombuffer"] = _from_buffer


class _Arrays(pickle.Unpickler):
    def find_class(self, module_name: str, global_name: str) -> Any:
        if (module_name, global_name) not in KNOWN:
            raise pickle.UnpicklingError(f"it names {module_name[:60]}.{global_name[:60]}, which could run code")
        return KNOWN[module_name, global_name]


class _Finish:
    """Replacement of the stand-ins by arrays; raises UnpicklingError for any other type of value, and for too many values."""

    def __init__(self) -> None:
        self.left = VALUES

    def __call__(self, value: Any) -> Any:
        self.left -= 1
        if self.left < 0:  # nested lists that each hold one list many times
            raise pickle.UnpicklingError(f"it holds more than {VALUES} values")
        if isinstance(value, (list, tuple)):
            return type(value)(self(v) for v in value)
        if isinstance(value, dict):
            return {self(k): self(v) for k, v in value.items()}
        if isinstance(value, _Array):
            value = value.value
        if isinstance(value, (np.ndarray, str, bytes, int, float, bool, type(None))):
            return value
        raise pickle.UnpicklingError(f"it holds a {type(value).__name__.lstrip('_')}")
