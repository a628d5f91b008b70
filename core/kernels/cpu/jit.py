# SPDX-License-Identifier: GPL-3.0-or-later
"""Compilation of CPU kernels: numba, releasing the GIL, cached on disk per version of the sources."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...machine.cache_folder import private_folder


def cache_folder() -> Path:
    """Return a writable folder named by a hash of the kernels' sources: numba's own cache misses edits of imported helpers."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for source in [*sorted(here.glob("*.py")), here.parent / "constants.py"]:
        digest.update(source.read_bytes())
    return private_folder(f"kernels-{digest.hexdigest()[:12]}")


os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder()))

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR on import)
from llvmlite.binding import get_host_cpu_name  # noqa: E402
from numba.core.caching import IndexDataCacheFile  # noqa: E402

# Sums may be contracted and reordered; NaN and infinity keep their meaning, so that errors stay visible.
FASTMATH = {"contract", "reassoc", "nsz", "arcp"}


def compiled_by() -> str:
    """Return numba's version and the name of this processor, for either of which kernels are compiled anew."""
    return f"{numba.__version__}-{get_host_cpu_name()}"


class KernelFiles(IndexDataCacheFile):
    """Cache files of the compiled versions of a kernel, each named by its argument types.

    numba numbers them. Processes that compile at the same time could give two versions the same number, and one would run the other's code.
    """

    def save(self, key: Any, data: Any) -> None:
        """Write a compiled version and enter it in the index.

        Args:
            key: signature and target that the version was compiled for.
            data: the compiled code, as numba serialises it.
        """
        name = self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:12], 16))
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})


def _compiled(function: Callable[..., Any], inlined: bool) -> Any:
    """Return numba's dispatcher of a function; it compiles at the first call with arguments of new types.

    Args:
        function: Python function in numba's subset of the language.
        inlined: True to copy its code into every function that calls it.
    """
    # Nothing calls the kernels from C, and each such entry point would hold another copy of the code.
    options: dict[str, Any] = {"nogil": True, "cache": True, "no_cfunc_wrapper": True, "forceinline": inlined}
    compiled: Any = numba.njit(function, fastmath=FASTMATH, error_model="numpy", **options)
    cache = compiled._cache
    cache._cache_file = KernelFiles(cache.cache_path, cache._impl.filename_base, cache._impl.locator.get_source_stamp())
    return compiled


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function(begin, end, ...)`, which Python calls. What it calls is a `helper`.

    Args:
        function: Python function in numba's subset of the language.
    """
    return _compiled(function, inlined=False)


def helper(function: Callable[..., Any]) -> Any:
    """Compile a function that kernels and other helpers call. Helpers shared between modules must live in this folder.

    Helpers are always inlined: a helper that is called could differ between freshly compiled code and code from the cache, with sums
    contracted differently, and the first run on a machine would differ from later ones.

    Args:
        function: Python function in numba's subset of the language.
    """
    return _compiled(function, inlined=True)
