# SPDX-License-Identifier: GPL-3.0-or-later
"""How CPU kernels are compiled: numba, without the GIL, cached on disk per version of the sources."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any


def cache_root() -> Path:
    """The user's cache folder for compiled kernels ($IRGSPP_CACHE wins)."""
    if "IRGSPP_CACHE" in os.environ:
        return Path(os.environ["IRGSPP_CACHE"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "irgspp"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "irgspp"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "irgspp"


def _claim(folder: Path) -> None:
    """Make a folder that only this user can write to; compiled code out of somebody else's would be theirs to choose."""
    folder.mkdir(exist_ok=True, mode=0o700)
    about = folder.lstat()
    if hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022):
        raise PermissionError(f"{folder} is open to others")


def cache_folder() -> Path:
    """A writable folder named by the kernels' sources: numba's own cache misses edits of imported helpers."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return private_folder(f"kernels-{digest.hexdigest()[:12]}")


def private_folder(name: str) -> Path:
    """A writable folder of that name in the cache, or else in one of the user's own among the temporary files."""
    fallback = Path(tempfile.gettempdir()) / f"irgspp-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    for root in (cache_root(), fallback):
        try:
            if root == fallback:
                _claim(root)
            (root / name).mkdir(parents=True, exist_ok=True, mode=0o700)
            (root / name / ".writable").touch()
            return root / name
        except OSError:
            continue
    raise OSError("no writable folder for compiled kernels; set IRGSPP_CACHE to one")


os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder()))

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR on import)
from numba.core.caching import IndexDataCacheFile  # noqa: E402

# Sums may be contracted and reordered; NaN and infinity keep their meaning, so that faults stay visible.
FASTMATH = {"contract", "reassoc", "nsz", "arcp"}


class KernelFiles(IndexDataCacheFile):
    """The files of a kernel's compiled versions, each named by what it was compiled for.

    numba numbers them. Processes that compile at once would give two versions the same number, and one would run the other's code.
    """

    def save(self, key: Any, data: Any) -> None:
        name = self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:12], 16))
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function(begin, end, ...)` or a helper of one. Helpers shared between modules must live in this folder.

    Helpers are always inlined: one that is called could be another copy in code just compiled than in code from the cache, with sums
    contracted otherwise, and the first run on a machine would differ from the later ones.
    """
    compiled: Any = numba.njit(function, nogil=True, cache=True, forceinline=True, fastmath=FASTMATH, error_model="numpy")
    cache = compiled._cache
    cache._cache_file = KernelFiles(cache.cache_path, cache._impl.filename_base, cache._impl.locator.get_source_stamp())
    return compiled
